"""The compass's parameters: what is taken, what is refused, and in which words."""

import dataclasses
import math

import pytest

from compass import CompassConfig, ConfigError, VisualCompass, VisualCompassError
from compass.config import METHODS
from compass.parameters import ParameterSet, ParameterSpec, parameter

SPECS = {spec.name: spec for spec in CompassConfig.specs()}
NUMBERS = [name for name, spec in SPECS.items() if type(spec.default) in (int, float)]
FLOATS = [name for name, spec in SPECS.items() if isinstance(spec.default, float)]


def valid_with(**changes):
    """Values that stand together with the changes: the region of interest stays open."""
    values = {}
    if "roi_top" in changes and changes["roi_top"] >= 0.55:
        values["roi_bottom"] = 1.0
    if "roi_bottom" in changes and changes["roi_bottom"] <= 0.25:
        values["roi_top"] = 0.0
    return {**values, **changes}


def test_defaults_are_usable():
    compass = VisualCompass()
    assert compass.config == CompassConfig()
    assert compass.config.method in METHODS


def test_the_fields_that_others_build_on_are_there():
    assert set(SPECS) >= {
        "method", "roi_top", "roi_bottom", "columns", "rows", "forward_column", "max_yaw_rate", "min_confidence",
    }  # fmt: skip


@pytest.mark.parametrize("name", SPECS)
def test_every_parameter_says_what_it_is(name):
    spec = SPECS[name]
    assert len(spec.description) > 10
    if name in NUMBERS:
        assert spec.low is not None
        assert spec.high is not None
        assert spec.low <= spec.default <= spec.high
    assert spec.check(spec.default) == spec.default


@pytest.mark.parametrize("name", NUMBERS)
def test_limits_belong_to_the_range(name):
    spec = SPECS[name]
    kind = type(spec.default)
    for limit in (spec.low, spec.high):
        if (name, limit) in {("roi_top", 1.0), ("roi_bottom", 0.0)}:
            continue  # would leave no region of interest
        config = CompassConfig(**valid_with(**{name: kind(limit)}))
        assert getattr(config, name) == limit


@pytest.mark.parametrize("name", NUMBERS)
def test_value_beyond_a_limit_is_refused_with_name_value_and_range(name):
    spec = SPECS[name]
    for value in (spec.low - 1, spec.high + 1):
        value = type(spec.default)(value)
        with pytest.raises(ConfigError) as caught:
            CompassConfig(**{name: value})
        for part in (name, repr(value), f"{spec.low:g}", f"{spec.high:g}"):
            assert part in str(caught.value)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", FLOATS)
def test_value_that_is_not_finite_is_refused(name, value):
    with pytest.raises(ConfigError, match=name):
        CompassConfig(**{name: value})


@pytest.mark.parametrize("name", SPECS)
@pytest.mark.parametrize("value", [None, [1], {}, b"rows", True, 1j])
def test_value_of_another_type_is_refused(name, value):
    value = 1 if type(value) is type(SPECS[name].default) else value  # of a switch
    with pytest.raises(ConfigError, match=f"{name}.*{type(SPECS[name].default).__name__}"):
        CompassConfig(**{name: value})


@pytest.mark.parametrize("name", NUMBERS)
def test_text_for_a_number_is_refused(name):
    with pytest.raises(ConfigError, match=name):
        CompassConfig(**{name: "1"})


def test_whole_number_is_taken_for_a_fraction_but_not_the_other_way():
    config = CompassConfig(max_yaw_rate=2)
    assert config.max_yaw_rate == 2.0
    assert type(config.max_yaw_rate) is float
    with pytest.raises(ConfigError, match=r"columns.*int"):
        CompassConfig(columns=512.0)


def test_unknown_method_is_refused_with_those_there_are():
    with pytest.raises(ConfigError, match="sectors") as caught:
        CompassConfig(method="sector")
    assert all(method in str(caught.value) for method in METHODS)


@pytest.mark.parametrize("method", METHODS)
def test_every_method_named_can_be_built(method):
    assert VisualCompass(CompassConfig(method=method)).config.method == method


@pytest.mark.parametrize(("top", "bottom"), [(0.5, 0.5), (0.6, 0.4), (1.0, 0.0), (0.0, 0.0), (1.0, 1.0)])
def test_region_of_interest_must_be_open(top, bottom):
    with pytest.raises(ConfigError, match=r"roi_bottom.*greater than roi_top"):
        CompassConfig(roi_top=top, roi_bottom=bottom)


def test_config_is_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        CompassConfig().columns = 7
    assert hash(CompassConfig()) == hash(CompassConfig())


@pytest.mark.parametrize(
    ("wrong", "meant"),
    [("colums", "columns"), ("Method", "method"), ("roi-top", "roi_top"), ("max_rate", "max_yaw_rate")],
)
def test_unknown_key_suggests_the_nearest(wrong, meant):
    with pytest.raises(ConfigError, match=f"{wrong!r}.*did you mean {meant!r}"):
        CompassConfig.from_dict({wrong: 1})


def test_unknown_key_like_nothing_lists_the_known():
    with pytest.raises(ConfigError) as caught:
        CompassConfig.from_dict({"zzzz": 1})
    assert all(name in str(caught.value) for name in SPECS)


@pytest.mark.parametrize("key", [3, None, ("a",)])
def test_key_that_is_no_name_is_refused(key):
    with pytest.raises(ConfigError, match="unknown parameter"):
        CompassConfig.from_dict({key: 1})


def test_place_in_a_file_is_part_of_the_message():
    with pytest.raises(ConfigError, match=r"^compass\.columns: 3 is outside"):
        CompassConfig.from_dict({"columns": 3}, where="compass.")
    with pytest.raises(ConfigError, match=r"did you mean compass\.'rows'"):
        CompassConfig.from_dict({"row": 3}, where="compass.")


def test_dict_and_back_is_the_same():
    config = CompassConfig(method="sectors", roi_top=0.1, roi_bottom=0.9, columns=777, rows=33, forward_column=0.125)
    assert CompassConfig.from_dict(config.to_dict()) == config
    assert list(config.to_dict()) == list(SPECS)
    assert CompassConfig.from_dict({}) == CompassConfig()


def test_error_is_the_projects_and_a_value_error():
    assert issubclass(ConfigError, VisualCompassError)
    assert issubclass(ConfigError, ValueError)


def test_switches_and_texts_are_checked_too():
    @dataclasses.dataclass(frozen=True)
    class Settings(ParameterSet):
        on: bool = parameter(False, "whether")
        name: str = parameter("a", "which")
        count: int = parameter(1, "how many")

    assert Settings(on=True, name="b").to_dict() == {"on": True, "name": "b", "count": 1}
    for bad in ({"on": 1}, {"on": "true"}, {"name": 1}, {"count": True}):
        with pytest.raises(ConfigError):
            Settings(**bad)
    assert Settings(count=-(10**9)).count == -(10**9)  # no limits named, none kept
    assert isinstance(next(Settings.specs()), ParameterSpec)
