"""The held-out places: any drive fits into them, they are pictures, and a seed chooses among them."""

import numpy as np
import pytest

from fusion.simulation import EXPERIMENTS, CameraPose, PanoramaCamera, SimulationError, simulate
from fusion.simulation.held_out import HELD_OUT
from fusion.simulation.worlds import HELD_OUT_WORLDS, TUNED_WORLDS, choose_world, held_out

# One drive for each place: spins, bends, long ways, and the one with people.
DRIVES = dict(
    zip(
        HELD_OUT,
        ("weave", "square20", "free_race_passage", "crowd", "demo", "stop_and_go", "demo", "weave"),
        strict=True,
    )
)
SMALL = PanoramaCamera(64, 32)


@pytest.fixture(scope="module", params=HELD_OUT)
def visit(request):
    """A place, the world built round a drive, and that drive."""
    experiment = EXPERIMENTS[DRIVES[request.param]]
    return request.param, held_out(experiment, request.param), experiment


def test_held_out_place_leaves_the_way_free(visit):
    _, world, experiment = visit
    motion = experiment.trajectory.at(np.arange(0.0, experiment.trajectory.duration, 0.2))
    assert world.clearance(motion.x, motion.y, headroom=np.inf) > 0.5
    assert world.clearance(motion.x, motion.y) < 6.0  # and has things beside it


def test_held_out_place_is_a_picture(visit):
    place, world, experiment = visit
    x, y, heading = experiment.trajectory.start
    image = PanoramaCamera(256, 128).render(world, CameraPose(x, y, 0.65, heading))
    assert 70.0 < image.mean() < 190.0, place
    assert image[32:70].std() > 8.0, place


def test_held_out_place_is_another_scene_for_every_seed(visit):
    place, world, experiment = visit
    other = held_out(experiment, place, seed=1)
    assert not {solid.low for solid in world.solids} & {solid.low for solid in other.solids}
    x, y, heading = experiment.trajectory.start
    views = [PanoramaCamera(128, 64).render(one, CameraPose(x, y, 0.65, heading)) for one in (world, other)]
    assert (np.abs(views[0] - views[1])[26:48] > 5.0).mean() > 0.05  # below the sky; the same scene: 0


def test_held_out_patches_of_light_move_over_what_stands_still():
    experiment = EXPERIMENTS["shifted"]
    world, camera, pose = (
        held_out(experiment, "moving_light"),
        PanoramaCamera(256, 128),
        CameraPose(0.0, 0.0, 0.65, 0.0),
    )
    before, after = (camera.render(world, pose, t)[32:70] for t in (1.0, 3.0))
    changed = np.abs(after - before) > 5.0
    assert 0.02 < changed.mean() < 0.5
    assert world.solids == world.at(1.0)[: len(world.solids)]


def test_held_out_world_is_chosen_by_the_seed_and_every_place_has_its_turn():
    chosen = {
        name: [choose_world(one, seed, HELD_OUT_WORLDS).name for seed in range(20)] for name, one in EXPERIMENTS.items()
    }
    assert {place for places in chosen.values() for place in places} == set(HELD_OUT)
    assert all(set(places[:8]) == set(HELD_OUT) for places in chosen.values())
    assert chosen == {
        name: [choose_world(one, seed, HELD_OUT_WORLDS).name for seed in range(20)] for name, one in EXPERIMENTS.items()
    }
    one = EXPERIMENTS["demo"]
    assert [choose_world(one, seed, TUNED_WORLDS).name for seed in (0, 6, 7, 14, 21)] == ["0", "0", "1", "2", "0"]
    assert choose_world(one, 3, "rubble").held_out
    assert not choose_world(one, 3, TUNED_WORLDS).held_out


def test_held_out_world_unknown_names_those_there_are():
    with pytest.raises(SimulationError, match=r"no worlds 'ruble'.*rubble"):
        simulate("demo", worlds="ruble")


def test_held_out_frames_are_cached_beside_the_tuned_and_the_same_every_time(tmp_path):
    def frame(worlds, folder=tmp_path):
        return simulate("shifted", 3, worlds=worlds, cache=folder, camera=SMALL).frame(0).tobytes()

    frames = {worlds: frame(worlds) for worlds in (TUNED_WORLDS, "colonnade", "white_gallery")}
    assert len(set(frames.values())) == 3
    assert len(list(tmp_path.iterdir())) == 3
    assert frames == {worlds: frame(worlds) for worlds in frames}
    assert frame("colonnade", tmp_path / "elsewhere") == frames["colonnade"]


def test_held_out_world_changes_nothing_but_the_frames(tmp_path):
    own, other = (simulate("square20", 4, worlds=worlds) for worlds in (TUNED_WORLDS, "rubble"))
    assert own.imu == other.imu
    assert own.odometry == other.odometry
    assert np.array_equal(own.frame_t_ns, other.frame_t_ns)
