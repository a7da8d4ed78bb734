"""Who may import whom; and that nothing but the nodes needs ROS."""

import ast
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
NUMERICS = {"numpy", "scipy", "cv2"}
ROOMS = {
    "compass": NUMERICS | {"compass"},
    "compass/images": NUMERICS | {"compass"},
    "compass/methods": NUMERICS | {"compass"},
    "compass/flow": NUMERICS | {"compass"},
    "compass/features": NUMERICS | {"compass"},
    "fusion": {"numpy", "scipy", "compass", "fusion", "filterpy"},
    "fusion/state": {"numpy", "scipy", "compass", "fusion", "filterpy"},
    "fusion/updates": {"numpy", "scipy", "compass", "fusion", "filterpy"},
    "fusion/buffer": {"numpy", "scipy", "compass", "fusion", "filterpy"},
    "fusion/checks": {"numpy", "scipy", "compass", "fusion"},
    "fusion/imu": {"numpy", "compass", "fusion"},
    "fusion/simulation": NUMERICS | {"compass", "fusion", "platformdirs"},
    "fusion/offline": NUMERICS
    | {"compass", "fusion", "rosbags", "mcap", "matplotlib", "click", "rich", "yaml"}
    | {"fsspec", "pyarrow"},  # of the extra `cluster`, each where it is needed
    "fusion/offline/report": NUMERICS | {"compass", "fusion", "bokeh"},
}
# parameter files are read by the one and written by the other
ALSO = {
    "fusion/bounded_yaml.py": {"yaml"},
    "fusion/settings.py": {"yaml"},
    "compass/images/video.py": {"av"},
    "fusion/offline/video_file.py": {"av", "telemetry_parser"},
    "fusion/offline/library.py": {"pandas"},
    "fusion/offline/allan.py": {"allantools"},
    "fusion/offline/rerun_export.py": {"rerun"},
}
# samples and their order, then what is wrong with them, then what is believed, then what a sensor changes of that
BEYOND = ("fusion.offline", "fusion.simulation", "fusion.state", "fusion.updates", "fusion.filter", "fusion.yaw_fusion")
NEVER = {
    "compass": ("fusion",),
    "compass/images": ("fusion", "compass.methods", "compass.features"),
    "compass/methods": ("fusion",),
    "compass/flow": ("fusion", "compass.features"),
    "compass/features": ("fusion",),
    "fusion": ("fusion.offline", "fusion.simulation"),
    "fusion/state": ("fusion.offline", "fusion.simulation", "fusion.updates", "fusion.filter", "fusion.yaw_fusion"),
    "fusion/updates": ("fusion.offline", "fusion.simulation", "fusion.filter", "fusion.yaw_fusion"),
    "fusion/buffer": (*BEYOND, "fusion.checks", "fusion.imu"),
    "fusion/checks": (*BEYOND, "fusion.imu"),
    "fusion/imu": BEYOND,
    "fusion/simulation": (
        *(f"compass.{name}" for name in ("visual_compass", "increment", "tilt", "images", "methods", "features")),
        *(f"fusion.{name}" for name in ("filter", "pipeline", "yaw_fusion", "smoother", "checks", "imu", "offline")),
    ),
}
HIDDEN = ("rclpy", "sensor_msgs", "nav_msgs", "std_msgs", "diagnostic_msgs", "builtin_interfaces", "nodes")
FILES = [(room, file) for room in ROOMS for file in sorted((ROOT / room).glob("*.py"))]


def imports(file: Path) -> set[str]:
    """Full names of the modules a file imports, wherever in it."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}: relative import"
            found |= {str(node.module)} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found


@pytest.mark.parametrize(("room", "file"), FILES, ids=[str(file.relative_to(ROOT)) for _, file in FILES])
def test_imports_stay_in_their_room(room, file):
    allowed = ROOMS[room] | ALSO.get(str(file.relative_to(ROOT)), set()) | sys.stdlib_module_names
    names = imports(file)
    assert {name.split(".")[0] for name in names} <= allowed
    for forbidden in NEVER.get(room, ()):
        assert not [name for name in names if name == forbidden or name.startswith(forbidden + ".")]


def test_imports_nothing_outside_the_nodes_imports_them():
    for file in ROOT.glob("*/**/*.py"):
        if file.relative_to(ROOT).parts[0] in ("compass", "fusion"):
            assert not {name for name in imports(file) if name.split(".")[0] in ("nodes", "rclpy")}, file


def test_imports_every_module_of_the_core_without_ros():
    """With rclpy and the message packages unimportable, everything but the nodes still imports."""
    modules = [".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__") for _, file in FILES]
    code = (
        "import sys, importlib\n"
        f"for name in {HIDDEN!r}:\n"
        "    sys.modules[name] = None\n"
        f"for name in {modules!r}:\n"
        "    importlib.import_module(name)\n"
        "import compass, fusion\n"
        "for package in (compass, fusion):\n"
        "    for name in package.__all__:\n"
        "        getattr(package, name)\n"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr


def test_imports_unknown_name_is_an_attribute_error():
    import compass

    with pytest.raises(AttributeError, match="module 'compass' has no attribute 'nothing'"):
        compass.nothing  # noqa: B018


def runs(code):
    """Run it in a process of its own, which has imported nothing yet."""
    result = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr


def test_imports_of_the_filter_leave_scipy_stats_to_who_uses_it():
    code = (
        "import sys\n"
        "from fusion.state.ekf import YawEkf\n"
        "import filterpy.kalman.EKF\n"
        "assert 'scipy.stats' not in sys.modules and 'filterpy.stats' not in sys.modules\n"
        "by_class = filterpy.kalman.EKF.logpdf(x=0.3, cov=2.0)\n"
        "assert by_class == filterpy.stats.logpdf(x=0.3, cov=2.0)\n"
        "from filterpy.stats import gaussian\n"
        "assert filterpy.stats is sys.modules['filterpy.stats'] and gaussian is filterpy.stats.gaussian\n"
        "assert 'scipy.stats' in sys.modules\n"
    )
    runs(code)


def test_imports_of_the_filter_take_what_somebody_has_imported_before():
    code = (
        "import filterpy.stats\n"
        "before = filterpy.stats\n"
        "import fusion.state.ekf, sys\n"
        "assert before is filterpy.stats is sys.modules['filterpy.stats'] and before.gaussian\n"
    )
    runs(code)


@pytest.mark.parametrize("node", ["fusion_node", "compass_node"])
def test_imports_of_a_node_are_what_it_uses(node):
    """On the robot: no bags, no plots, no command line."""
    pytest.importorskip("rclpy", reason="rclpy is not installed: pip install '.[ros]'")
    hidden = ["rosbags", "mcap", "matplotlib", "click", "rich", "platformdirs", "fusion.offline", "fusion.simulation"]
    code = f"import sys\nfor name in {hidden!r}:\n    sys.modules[name] = None\nimport nodes.{node}\n"
    runs(code)


@pytest.mark.parametrize("command", [["-m", "nodes.fusion_node"], ["nodes/executables/fusion_node"]])
def test_imports_end_silently_with_ctrl_c(command):
    """As soon as the first line of ours has run; a module that signals stands for a user at the keyboard."""
    pytest.importorskip("rclpy", reason="rclpy is not installed: pip install '.[ros]'")
    environment = dict(os.environ, PYTHONPATH=f"{ROOT / 'tests' / 'interrupting'}{os.pathsep}{ROOT}")
    result = subprocess.run(
        [sys.executable, *command], cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )
    assert (result.returncode, result.stdout, result.stderr) == (-signal.SIGINT, "", "")
