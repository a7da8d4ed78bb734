"""The timeline: any order of arrival gives the result of the order of stamps, to the bit."""

import math
import random
import weakref
from dataclasses import dataclass, replace

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from sensor_model import drawn_drive, far_increments

from compass import YawIncrement
from fusion import FusionConfig, GyroSample, OdometrySample, YawFusion
from fusion.buffer.replay import RECENT, SPACING, Arrival, Timeline


@dataclass(frozen=True)
class Letter:
    t_ns: int
    name: str

    @property
    def order(self):
        return (self.t_ns, ord(self.name))


def spelling(window_ns=100):
    return Timeline("", lambda state, letter: state + letter.name, window_ns)


def test_late_event_is_put_in_its_place():
    timeline = spelling()
    arrivals = [timeline.add(Letter(t, name)) for t, name in [(10, "a"), (30, "c"), (20, "b"), (30, "c")]]
    assert arrivals == [Arrival.APPENDED, Arrival.APPENDED, Arrival.LATE, Arrival.DUPLICATE]
    assert timeline.state == "abc"


def test_event_older_than_window_is_refused():
    timeline = spelling()
    timeline.add(Letter(1000, "b"))
    assert timeline.add(Letter(899, "a")) is Arrival.TOO_OLD
    assert timeline.add(Letter(900, "a")) is Arrival.LATE
    assert timeline.state == "ab"


def test_memory_stays_bounded():
    timeline = spelling(window_ns=100)
    for t in range(5000):
        timeline.add(Letter(t, "x"))
    assert len(timeline) < 300
    assert len(timeline.state) == 5000


def test_few_states_are_kept_and_few_more_steps_replayed():
    class Spelt(str):
        """A word that can be referred to weakly."""

    alive, steps = weakref.WeakSet(), []

    def step(state, letter):
        steps.append(letter.t_ns)
        word = Spelt(state + letter.name + str(letter.t_ns))  # no two are equal, of which a set would count one
        alive.add(word)
        return word

    timeline = Timeline(Spelt(), step, 2000)
    for t in range(0, 2000, 2):
        timeline.add(Letter(t, "x"))
    assert len(alive) <= RECENT + 1000 / SPACING + 1
    for late in (1, RECENT - 1, RECENT + 3, 500, 900):
        steps.clear()
        timeline.add(Letter(2000 - 2 * late + 1, "y"))
        most = late if late < RECENT else late + SPACING
        assert late <= len(steps) <= most + len(timeline) - 1000, late
    assert timeline.state == "".join(f"{event.name}{event.t_ns}" for event in timeline.after(-1))
    assert len(alive) <= RECENT + len(timeline) / SPACING + 2


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 400), st.sampled_from("abc")), max_size=40), st.randoms())
def test_any_order_inside_window_spells_the_same(pairs, rng):
    letters = [Letter(*pair) for pair in pairs]
    ordered, shuffled = spelling(400), spelling(400)
    for letter in sorted(set(letters), key=lambda letter: letter.order):
        ordered.add(letter)
    rng.shuffle(letters)
    for letter in letters:
        shuffled.add(letter)
    assert shuffled.state == ordered.state


DRAWN = drawn_drive(0, seconds=3.0, hold=0.4)
DRIVE = sorted([*DRAWN.samples, *far_increments(DRAWN, 0)], key=lambda sample: sample.t_ns)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32), st.floats(0.0, 0.95))
def test_any_arrival_inside_lag_window_gives_the_same_bits(seed, lateness):
    rng = random.Random(seed)
    arrivals = sorted(((s.t_ns + rng.uniform(0.0, lateness) * 1e9, i) for i, s in enumerate(DRIVE)))
    arrivals += [arrivals[-1]] * 3  # and some twice
    ordered, late = YawFusion(), YawFusion()
    for sample in DRIVE:
        ordered.add(sample)
    for _, i in arrivals:
        late.add(DRIVE[i])
    assert late.estimate() == ordered.estimate()
    assert late.state.x.tobytes() == ordered.state.x.tobytes()
    assert late.state.P.tobytes() == ordered.state.P.tobytes()
    assert late.reports() == ordered.reports()


def test_increment_after_a_late_one_keeps_its_reference():
    """Each refers to the last image but one: the filter need not remember that until one comes in between."""
    step_ns, sound = 100_000_000, 1e-6
    gyro = [GyroSample(k * step_ns // 10, 0.3) for k in range(400)]
    images = [YawIncrement((k - 2) * step_ns, k * step_ns, 0.06, sound, 0.9) for k in range(3, 40)]
    samples = sorted([*gyro, *images], key=lambda sample: sample.t_ns)
    odd = {image.t_ns for image in images[1::2]}
    ordered, late = YawFusion(), YawFusion()
    for sample in samples:
        ordered.add(sample)
    for sample in sorted(
        samples, key=lambda s: s.t_ns + 15 * step_ns // 10 * (s.t_ns in odd and isinstance(s, YawIncrement))
    ):
        late.add(sample)
    assert late.state.references_lost == ordered.state.references_lost == 0
    assert late.state.x.tobytes() == ordered.state.x.tobytes()
    assert late.state.P.tobytes() == ordered.state.P.tobytes()


def test_duplicates_change_nothing_and_are_counted():
    once, twice = YawFusion(), YawFusion()
    for sample in DRIVE:
        once.add(sample)
        assert twice.add(sample)
        assert not twice.add(sample)
    assert once.estimate() == twice.estimate()
    assert sum(n for reason, n in twice.counts.items() if reason.endswith("duplicate")) == len(DRIVE)


def test_older_than_lag_window_is_refused_and_counted():
    fusion = YawFusion()
    fusion.add(GyroSample(10_000_000_000, 0.1))
    before = fusion.estimate()
    assert not fusion.add(GyroSample(8_999_999_999, 0.5))
    assert fusion.estimate() == before
    assert fusion.counts["gyro: older than lag_window"] == 1
    assert fusion.add(GyroSample(9_000_000_000, 0.1))


def test_jump_back_in_time_goes_on_from_the_yaw_it_had_with_an_unknown_turn():
    fusion, fresh = YawFusion(), YawFusion()
    for sample in DRIVE:
        fusion.add(GyroSample(sample.t_ns + 100_000_000_000, 0.3))
    before = fusion.estimate().yaw
    for sample in DRIVE:
        fusion.add(sample)
        fresh.add(sample)
    assert fusion.counts["reset: time jumped back"] == 1
    after, anew = fusion.estimate(), fresh.estimate()
    assert after.t_ns == anew.t_ns
    assert after.yaw == pytest.approx(before + anew.yaw, abs=1e-6)  # no sample of the new time is lost
    assert after.yaw_variance > math.pi**2 / 3.0


def test_single_stray_stamp_does_not_reset():
    fusion = YawFusion()
    for i in range(300):
        fusion.add(GyroSample(50_000_000_000 + i * 10_000_000, 0.5))
        fusion.add(GyroSample(i, 0.5))
    assert fusion.estimate().yaw == pytest.approx(0.5 * 2.99, abs=0.2)
    assert not any(reason.startswith("reset") for reason in fusion.counts)


SECOND = 1_000_000_000
AHEAD = [3 * SECOND, 3600 * SECOND, 10**18]


def shifted(sample, by_ns):
    return replace(sample, t_ns=sample.t_ns + by_ns)


@pytest.mark.parametrize("by_ns", AHEAD)
@pytest.mark.parametrize("kind", [GyroSample, OdometrySample, YawIncrement])
def test_stamp_far_ahead_is_not_believed(kind, by_ns):
    clean, spoilt = YawFusion(), YawFusion()
    wrong = shifted(next(s for s in DRIVE if isinstance(s, kind) and s.t_ns > SECOND), by_ns)
    for number, sample in enumerate(DRIVE):
        clean.add(sample)
        spoilt.add(sample)
        if number == len(DRIVE) // 2:
            assert not spoilt.add(wrong)
            assert spoilt.estimate() == clean.estimate()
    assert spoilt.estimate() == clean.estimate()
    assert sum(n for reason, n in spoilt.counts.items() if reason.endswith("far ahead of all others")) == 1
    assert not any(reason.startswith("reset") for reason in spoilt.counts)


@pytest.mark.parametrize("by_ns", AHEAD)
def test_sensor_whose_clock_is_ahead_is_refused_for_good(by_ns):
    clean, spoilt = YawFusion(), YawFusion()
    for sample in DRIVE:
        ahead = isinstance(sample, OdometrySample)
        spoilt.add(shifted(sample, by_ns) if ahead else sample)
        if not ahead:
            clean.add(sample)
    assert [(w.code, w.sensor) for w in spoilt.estimate().warnings] == [("clock_mismatch", "tracks")]
    assert replace(spoilt.estimate(), warnings=()) == clean.estimate()
    assert spoilt.counts["tracks: far ahead of all others"] == sum(isinstance(s, OdometrySample) for s in DRIVE)


@pytest.mark.parametrize("kinds", [(GyroSample,), (YawIncrement,), (GyroSample, OdometrySample)])
def test_silence_of_all_ends_once_a_second_sample_confirms_the_time(kinds):
    """Of two sensors the first two samples do; one alone has to go on for 0.2 s."""
    fusion = YawFusion()
    before = [s for s in DRIVE if isinstance(s, kinds)]
    for sample in before:
        fusion.add(sample)
    after = [shifted(s, 60 * SECOND) for s in before if s.t_ns > SECOND]
    taken = [fusion.add(sample) for sample in after]
    believed_ns = after[taken.index(True)].t_ns
    assert all(taken[taken.index(True) :])
    assert believed_ns - after[0].t_ns <= (200_000_000 if len(kinds) == 1 else 30_000_000)
    assert fusion.estimate().t_ns == after[-1].t_ns
    assert sum(n for reason, n in fusion.counts.items() if reason.endswith("in order")) == len(before) + len(after)


def with_gap(sample):
    """The drive with five silent seconds in its middle."""
    sample = shifted(sample, 5 * SECOND) if sample.t_ns > 1.5 * SECOND else sample
    if isinstance(sample, YawIncrement) and sample.t_ref_ns > 1.5 * SECOND:
        sample = replace(sample, t_ref_ns=sample.t_ref_ns + 5 * SECOND)
    return sample


KNOWN = 5  # samples


@settings(max_examples=8, deadline=None)
@example(2**32 - 1, 0.5)
@given(st.integers(0, 2**32), st.floats(0.0, 0.95))
def test_any_arrival_with_silences_and_wrong_stamps_gives_the_same_bits(seed, lateness):
    rng = random.Random(seed)
    drive = [with_gap(sample) for sample in DRIVE]
    ordered, late = YawFusion(), YawFusion()
    for sample in drive:
        ordered.add(sample)
    arrivals = [(s.t_ns + rng.uniform(0.0, lateness) * 1e9, s) for s in drive]
    wrong = [shifted(s, (k + 2) * 10 * SECOND) for k, s in enumerate(rng.sample(drive, 20))]
    arrivals += [(rng.choice(drive).t_ns + 1e8, s) for s in wrong]
    # before anything is known, no stamp can be told to be wrong: two that are may outvote a single sample
    arrivals.sort(key=lambda arrival: arrival[0])
    known = next(k for k in range(len(arrivals)) if sum(s not in wrong for _, s in arrivals[:k]) == KNOWN)
    arrivals = [(t, s) for k, (t, s) in enumerate(arrivals) if k >= known or s not in wrong]
    for _, sample in arrivals:
        late.add(sample)
    assert late.state.x.tobytes() == ordered.state.x.tobytes()
    assert late.state.P.tobytes() == ordered.state.P.tobytes()
    assert late.estimate() == ordered.estimate()
    assert not any(reason.startswith("reset") for reason in late.counts)


def test_first_stamp_far_in_the_past_is_forgotten():
    fresh, spoilt = YawFusion(), YawFusion()
    spoilt.add(GyroSample(1, 0.0))
    for sample in DRIVE:
        fresh.add(shifted(sample, 3600 * SECOND))
        spoilt.add(shifted(sample, 3600 * SECOND))
    assert spoilt.estimate() == fresh.estimate()


def test_stamp_a_little_ahead_does_not_start_anew():
    """Without a lag window all that follows is too old for 0.9 s, and then the others have caught up."""
    fusion = YawFusion(FusionConfig(lag_window=0.0))
    for i in range(300):
        fusion.add(GyroSample(i * 10_000_000, 0.5))
        if i == 100:
            fusion.add(GyroSample(1_900_000_000, 0.5))
    assert fusion.estimate().yaw == pytest.approx(1.495, abs=0.02)
    assert not any(reason.startswith("reset") for reason in fusion.counts)


def test_only_sensor_is_believed_however_slow_it_is():
    """A camera of half a hertz: nobody can contradict its stamps."""
    fusion = YawFusion()
    taken = [fusion.add(YawIncrement(2 * i * SECOND, 2 * (i + 1) * SECOND, 0.1, 1e-6, 0.9)) for i in range(6)]
    assert taken.count(False) <= 1  # the second waits for the third, which tells its pace
    assert fusion.estimate().t_ns == 12 * SECOND
    assert fusion.estimate().yaw == pytest.approx(0.6, abs=1e-3)


def test_what_waits_to_be_confirmed_is_taken_in_at_the_end():
    fusion = YawFusion()
    fusion.add(YawIncrement(0, SECOND, 0.1, 1e-6, 0.9))
    assert not fusion.add(YawIncrement(SECOND, 4 * SECOND, 0.2, 1e-6, 0.9))
    fusion.flush()
    assert fusion.estimate().t_ns == 4 * SECOND
    assert fusion.estimate().yaw == pytest.approx(0.3, abs=1e-3)


@pytest.mark.parametrize("old_s", [1.5, 3600.0])
def test_burst_of_old_samples_of_one_sensor_is_no_jump_of_time(old_s):
    clean, spoilt = YawFusion(), YawFusion()
    for number, sample in enumerate(DRIVE):
        clean.add(shifted(sample, 10**18))
        spoilt.add(shifted(sample, 10**18))
        if number == len(DRIVE) // 2:
            for k in range(50):
                spoilt.add(GyroSample(10**18 + sample.t_ns - round(old_s * SECOND) + k * 10_000_000, 0.3))
    assert spoilt.estimate() == clean.estimate()


def test_clock_that_goes_back_within_the_lag_window_is_not_sorted_among_what_was_there():
    """The stamps of the IMU go back by 0.5 s: the same time again, with what the robot did half a second later."""
    fusion = YawFusion()
    for k in range(300):
        t_ns = 10**18 + k * 10_000_000 - (504_000_000 if k >= 150 else 0)
        fusion.add(GyroSample(t_ns, 0.0 if k < 150 else 1.0))
        if k % 2 == 0:
            fusion.add(OdometrySample(10**18 + k * 10_000_000, 0.0, 0.0))
    assert fusion.counts["gyro: its stamp repeats or goes back"] >= 50
    assert "stamps_not_increasing" in [warning.code for warning in fusion.estimate().warnings]
