"""Rules of fault isolation, a window at a time."""

import math
from dataclasses import replace

import pytest

from compass import YawIncrement
from fusion.buffer.events import Sensor
from fusion.checks.alternative import Third
from fusion.checks.contradiction import contradict
from fusion.checks.exclusion import Exclusion
from fusion.checks.gyro_faults import surely_gyro
from fusion.checks.isolation import Isolation
from fusion.checks.isolation_rules import judge
from fusion.checks.rate_turn import RateTurn
from fusion.checks.recovery import Recovery
from fusion.checks.stillness import CompassTurn
from fusion.checks.windows import Claim, Window

S = 500_000_000  # ns, a window


def rad(degrees):
    return math.radians(degrees)


def window(
    index, gyro=None, tracks=None, compass=None, followed=0.0, *, change=0.0, beyond=False, part=False, scale=0.0
):
    """A window of half a second; turns in deg, `scale` the standard deviation of the gyro's scale factor."""
    claims = [
        None if turn is None else Claim(rad(turn), rad(noise), scale)
        for turn, noise, scale in ((gyro, 0.02, scale), (tracks, 0.4, 0.0), (compass, 0.04, 0.0))
    ]
    times = index * S, (index + 1) * S
    return Window(*times, *claims, rad(followed), rate_change=change, gyro_beyond=beyond, part=part)


class Robot:
    """Follows what is judged: the yaw it has turned by, deg, the gyro's bias and the turn rate it is given, deg/s."""

    def __init__(self):
        self.iso, self.yaw, self.bias, self.rate, self.index = Isolation(), 0.0, 0.0, None, 0

    def see(self, gyro=None, tracks=None, compass=None, **kind):
        """One window; `gyro` with its true bias of none."""
        corrected = None if gyro is None else gyro - self.bias * 0.5
        excluded = self.iso.excludes(Sensor.GYRO)
        followed = compass if excluded or corrected is None else corrected
        self.yaw += followed
        one = window(self.index, corrected, tracks, compass, followed, **kind)
        self.iso, remedy = judge(self.iso, one, rad(self.bias))
        self.index += 1
        self.yaw += math.degrees(remedy.shift)
        if remedy.bias is not None:
            self.bias = math.degrees(remedy.bias)
        if remedy.rate is not None:
            self.rate = math.degrees(remedy.rate)


def test_images_that_do_not_turn_are_left_out_though_first_a_bias_explained_them():
    robot = Robot()
    for turn in (0.0, 10.0, 10.0, 10.0):
        robot.see(gyro=turn, compass=0.0)
    assert robot.yaw == pytest.approx(0.0, abs=0.1)  # a bias of 20 deg/s explains all of that
    for turn in (4.0, 0.0, 8.0):
        robot.see(gyro=turn, compass=0.0)
    assert robot.yaw == pytest.approx(42.0, abs=0.1)
    assert robot.bias == pytest.approx(0.0, abs=0.1)
    assert robot.iso.excludes(Sensor.COMPASS)
    assert math.degrees(math.sqrt(robot.iso.variance(robot.index * S))) > 42.0 / 3.0


def test_bias_that_steps_is_found_and_the_images_are_followed():
    robot = Robot()
    for turn in (0.0, 5.0, 0.0, 0.0, 6.0, 3.0):
        robot.see(gyro=turn + 5.0, compass=turn)
    assert robot.yaw == pytest.approx(14.0, abs=0.1)
    assert robot.bias == pytest.approx(10.0, abs=0.1)


def test_bias_that_steps_within_a_window_counts_from_there():
    """Half of it shows in the first window, too little to contradict; the images claim both."""
    robot = Robot()
    robot.see(gyro=5.0, compass=5.0)
    robot.see(gyro=5.45, compass=5.0)
    robot.see(gyro=5.9, compass=5.0)
    claimed = robot.iso.alternative(Sensor.COMPASS)
    assert math.degrees(claimed.offset) == pytest.approx(-0.45 - 0.9)


def test_small_step_of_the_bias_shows_in_several_windows():
    """The images are followed, the bias is forgotten, and that there was no step stays possible."""
    robot = Robot()
    for turn in (0.0, 0.0, 0.5, 1.0, 0.0):
        robot.see(gyro=turn + 0.3, compass=turn)
    assert not robot.iso.exclusions
    alternative = robot.iso.alternative(Sensor.GYRO)
    assert alternative is not None
    assert math.degrees(alternative.offset) > 0.5
    assert robot.yaw == pytest.approx(1.5 + 3 * 0.3)  # what the windows until then had added is taken back


def test_windows_of_a_turn_that_is_over_give_a_robot_that_stands_no_turn_rate():
    robot = Robot()
    for turn in (15.0, 15.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0):
        robot.see(gyro=turn + 0.08, compass=turn)
        if robot.rate is not None:
            break
    assert robot.rate == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize(("scale", "steps"), [(0.008, False), (0.001, True)])
def test_what_may_be_a_scale_factor_is_no_step_of_the_bias(scale, steps):
    """As it may be as long as nobody has learnt the factor."""
    robot = Robot()
    for turn in (8.0, 8.0, 8.0, 8.0):
        robot.see(gyro=1.05 * turn, compass=turn, scale=scale)
    assert bool(robot.iso.alternatives) is steps
    assert not robot.iso.exclusions


def test_windows_from_one_keyframe_have_the_noise_of_two_images_together():
    """What the image between them erred by is in both, with the opposite sign."""
    first, last, variance = 0, 4, 1e-6
    increments = [YawIncrement(first, first + k, 0.01 * k, variance, 1.0) for k in range(1, last + 1)]
    claims, turn = [], CompassTurn.begin(increments[0])
    for increment in increments[1:]:
        turn = turn.add(increment)
        claims.append(Claim(turn.turn, math.sqrt(turn.turn_variance), begin=turn.first, end=turn.last))
        turn = CompassTurn.begin(increment)
    joined = claims[0].plus(claims[1]).plus(claims[2])
    assert joined.turn == pytest.approx(0.03)
    assert joined.noise**2 == pytest.approx(2.0 * variance)


def test_late_gyro_is_not_believed_for_turning_steadily():
    robot = Robot()
    robot.see(gyro=0.0, tracks=10.0, compass=10.0, change=0.4)
    assert robot.iso.excludes(Sensor.GYRO)
    for _ in range(6):
        robot.see(gyro=10.0 + robot.bias * 0.5, tracks=10.0, compass=10.0)
    assert robot.iso.excludes(Sensor.GYRO)


@pytest.mark.parametrize(("gyro", "turn", "well"), [(8, 8, False), (8, 9, False), (9, 9, True), (-8, -8, True)])
def test_gyro_shows_that_a_bias_is_its_own_only_where_the_rate_is_another_than_when_it_was_found(gyro, turn, well):
    """One of zeros agrees at about that rate, too, though in other windows it has erred by 20 deg."""
    out = Exclusion(Sensor.GYRO, 0, 0.0, 0.03, 0.0, Recovery(squares=10.0, windows=15), fitted=rad(2.0 * 8.0))
    for index in range(9):
        one = window(index, gyro=gyro, compass=turn)
        out = out.weighed(replace(one.gyro, noise=rad(0.3)), one.compass, one)
    assert out.recovery.well is well


def test_gyro_that_turns_as_no_robot_does_stays_out():
    robot = Robot()
    for _ in range(4):
        robot.see(gyro=570.0, tracks=10.0, compass=10.0, beyond=True)
    for turn in (0.0, 10.0, 0.0, 10.0, 20.0):
        robot.see(gyro=turn, tracks=turn, compass=turn, change=0.3)
    assert robot.iso.excludes(Sensor.GYRO)
    assert robot.bias == 0.0  # nor is that a bias


def test_third_sensor_that_contradicts_both_takes_no_side():
    slips, agrees, stands, turns = (Claim(rad(turn), rad(0.4)) for turn in (12.0, 3.0, 0.0, 3.0))
    assert Third().plus(slips, stands, turns).side is None
    assert Third().plus(agrees, stands, turns).side is True
    assert Third().plus(slips, stands, turns).plus(stands, stands, turns).side is False


def test_third_sensor_does_not_decide_against_one_that_is_too_vague_itself():
    stands, turns = Claim(0.0, rad(0.1)), Claim(rad(5.0), rad(0.1))
    assert Third().plus(stands, stands, turns).side is False
    assert Third().plus(stands, stands, replace(turns, noise=rad(5.0))).side is None


@pytest.mark.parametrize("scale", [0.0, 0.3])
@pytest.mark.parametrize("factor", [1.0, 1.4])
def test_third_sensor_takes_the_side_of_who_turns_when_it_does(scale, factor):
    """Its scale factor may be another; that the other one hangs is no matter of scale."""
    third = Third()
    for turn in (0.0, 8.0, -6.0):
        third = third.plus(Claim(rad(factor * turn), rad(0.4), scale), Claim(rad(turn), 0.0), Claim(0.0, 0.0))
    assert third.side is False
    assert third.swapped().side is True


def test_third_sensor_of_unknown_scale_does_not_decide_which_of_two_factors_is_right():
    third = Third()
    for turn in (10.0, -20.0):
        third = third.plus(Claim(rad(1.4 * turn), rad(0.4), 0.3), Claim(rad(turn), 0.0), Claim(rad(2.0 * turn), 0.0))
    assert third.side is None


def test_images_that_say_they_are_no_full_circle_are_no_alternative():
    robot = Robot()
    robot.see(gyro=10.0, compass=20.0, part=True)
    assert robot.iso.excludes(Sensor.COMPASS)
    assert not robot.iso.alternatives
    assert robot.yaw == pytest.approx(10.0, abs=0.1)


def test_who_was_followed_before_images_said_so_is_left_and_the_yaw_owes_it():
    robot = Robot()
    for turn in (10.0, 12.0, 0.0, 8.0):
        robot.see(gyro=turn, compass=2.0 * turn)
    assert robot.iso.alternative(Sensor.GYRO) or robot.iso.alternative(Sensor.COMPASS)
    robot.see(gyro=5.0, compass=10.0, part=True)
    assert robot.iso.excludes(Sensor.COMPASS)
    assert not robot.iso.excludes(Sensor.GYRO)
    assert not robot.iso.alternatives
    assert robot.yaw == pytest.approx(35.0, abs=2.5)


def test_no_scale_factor_makes_a_turn_of_none():
    """Tracks of which next to nothing is known contradict a gyro that claims no turn, not one that claims half."""
    tracks = Claim(0.5, 0.01, scale=0.5)
    assert contradict(tracks, Claim(0.0, 0.001), 0.5)
    assert not contradict(tracks, Claim(0.4, 0.001), 0.5)


@pytest.mark.parametrize(
    ("times", "turn", "surely"), [(57.3, 10.0, True), (57.3, 2.0, True), (57.3, 0.5, False), (10.0, 10.0, False)]
)
def test_gyro_in_degrees_is_told_by_its_ratio_to_a_turn_that_is_large_enough(times, turn, surely):
    """A bias makes a ratio of 57 to a turn of half a degree."""
    assert surely_gyro(window(0, gyro=times * turn, compass=turn), rad(turn)) == surely


def integral(rates, hz=50):
    """Turn in rad of samples that are `hz` apart."""
    turn = RateTurn.begun(0, rates[0])
    for k, rate in enumerate(rates[1:], start=1):
        turn = turn.add(k * 10**9 // hz, rate)
    return turn.turn_until((len(rates) - 1) * 10**9 // hz)


@pytest.mark.parametrize("spike", [[8.0], [-20.0], [8.0, 8.0, 8.0], [8.0, -8.0]])
def test_turn_of_spikes_is_left_out(spike):
    plain = [0.01 * k for k in range(100)]
    spiked = [*plain[:40], *spike, *plain[40 + len(spike) :]]
    assert integral(spiked) == pytest.approx(integral(plain), abs=1e-3)


@pytest.mark.parametrize("off", [0.8, -2.0, 20.0])
def test_turn_of_a_gyro_that_goes_on_so_counts(off):
    rates = [0.1] * 40 + [0.1 + off] * 60
    assert integral(rates) == pytest.approx(0.1 * 0.8 + (0.1 + off) * 1.18, rel=0.02)


def test_tracks_turn_as_their_poses_say_where_they_have_any():
    yaw = [0.2 * k * 0.1 for k in range(30)]
    turn = RateTurn.begun(0, 0.0, yaw[0])
    for k in range(1, 15):
        turn = turn.add(k * 10**8, 0.0, yaw=yaw[k])  # its rate lags
    assert turn.turn == pytest.approx(yaw[14])
    later = turn.anew(1_450_000_000)
    for k in range(15, 30):
        later = later.add(k * 10**8, 0.0, yaw=yaw[k])
    assert later.turn_until(2_900_000_000) == pytest.approx(0.2 * 1.45)
    assert RateTurn.begun(0, 0.0, 3.1).add(10**8, 0.0, yaw=-3.1).turn == pytest.approx(math.tau - 6.2)


def standing(gyro_rates, tracks_speak_at=99):
    """Windows of a gyro, deg in each, beside tracks that say zero; who is excluded after each."""
    iso, bias, seen = Isolation(), 0.0, []
    for index, turn in enumerate(gyro_rates):
        claims = Claim(rad(turn) - bias * 0.5, rad(0.02)), Claim(0.0, rad(0.1)), None
        one = Window(index * S, (index + 1) * S, *claims, 0.0, tracks_spoke=index >= tracks_speak_at)
        iso, remedy = judge(iso, one, bias)
        bias = bias if remedy.bias is None else remedy.bias
        seen.append([exclusion.sensor for exclusion in iso.exclusions])
    return seen, math.degrees(bias) * 0.5


def test_gyro_that_turns_at_one_rate_beside_tracks_that_never_moved_has_a_bias():
    seen, bias = standing([1.5, 1.52, 1.5, 1.5])
    assert seen[0] == []
    assert seen[1] == [Sensor.GYRO]
    assert Sensor.TRACKS not in seen[-1]
    assert bias == pytest.approx(1.5, abs=0.05)


def test_tracks_that_never_moved_are_dead_where_the_rate_changes_and_heard_again_once_they_speak():
    seen, bias = standing([1.5, 15.0, 15.0, 0.0, 0.0], tracks_speak_at=3)
    assert seen[1] == seen[2] == [Sensor.TRACKS]
    assert seen[3] == []
    assert bias == 0.0


def test_gyro_that_errs_beside_silent_tracks_is_not_heard_again_because_they_speak():
    seen, _ = standing([1.5, 1.5, 10.0, 20.0], tracks_speak_at=3)
    assert seen[1] == seen[2] == seen[3] == [Sensor.GYRO]
