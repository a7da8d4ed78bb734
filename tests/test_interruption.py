"""A signal ends a command wherever it finds it."""

import signal
import subprocess
import sys

import pytest

import visual_compass

WAITS = """
import signal, sys, time, weakref
from fusion.offline.interruption import Interrupted, interruptible

class Thing:
    pass

class Last:
    def __del__(self):
        signal.raise_signal({number})
        "here the handler runs"

def callback(_):
    signal.raise_signal({number})
    "here the handler runs"

def destructor():
    Last()

def weak_reference():
    thing = Thing()
    reference = weakref.ref(thing, callback)
    del thing

def code():
    signal.raise_signal({number})

try:
    with interruptible():
        {place}()
        time.sleep(600)
except Interrupted as interrupted:
    sys.exit(128 + interrupted.number)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("place", ["code", "destructor", "weak_reference"])
def test_interruption_is_heard_where_python_ignores_what_is_raised(place, number):
    code = WAITS.format(place=place, number=int(number))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300, check=False)
    assert (done.returncode, done.stderr) == (128 + number, "")


def test_interruption_while_the_command_loads_is_a_line(monkeypatch, capsys):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(visual_compass, "check_packages", interrupted)
    assert visual_compass.main() == 130
    assert capsys.readouterr().err == "visual-compass: interrupted\n"


def test_interruption_leaves_signals_and_hooks_as_they_were():
    from fusion.offline.interruption import Interrupted, interruptible

    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGALRM)
    before = [signal.getsignal(number) for number in numbers], sys.unraisablehook
    with pytest.raises(Interrupted), interruptible():
        signal.raise_signal(signal.SIGTERM)
    assert ([signal.getsignal(number) for number in numbers], sys.unraisablehook) == before
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
