"""Protocols: reading, the fixture that runs them, and what is refused."""

import numpy as np
import pytest

from srt.exceptions import InputError
from srt.recording.protocol import load_protocol, protocol_from_dict, protocol_names

SHIPPED = {
    "six-face-tumble", "24-face-tumble", "rate-table", "7-positions", "9-positions", "11-positions", "19-positions",
    "two-axis-table", "ferraris", "hand-turned", "table-1",
}  # fmt: skip


def test_shipped_protocols_are_read_and_last_as_long_as_asked():
    assert set(protocol_names()) == SHIPPED
    for name in protocol_names():
        protocol = load_protocol(name)
        assert protocol.description
        assert protocol.lasting(900.0).total_s == pytest.approx(900.0, rel=1e-12)


def test_nineteen_positions_are_those_of_the_literature():
    protocol = load_protocol("19-positions")
    turns = [("xyz"[int(np.argmax(axis))], round(np.degrees(a))) for s in protocol.steps for axis, a in s.rotations]
    assert turns == [
        *[("y", 90)] * 3, *[("y", -90)] * 3, ("z", 90), *[("x", 90)] * 3, *[("x", -90)] * 3, *[("z", 90)] * 2,
        *[("z", -90)] * 3,
    ]  # fmt: skip
    assert protocol.total_s == 60.0 + 18 * 9.0 + 60.0 + 17 * 20.0


@pytest.mark.parametrize(
    ("name", "stated"),
    [
        *((name, True) for name in ("table-1", "six-face-tumble", "ferraris", "two-axis-table")),
        *((name, False) for name in ("7-positions", "11-positions", "19-positions")),
    ],
)
def test_protocols_of_the_fixture_run_on_it(name, stated):
    """Without a stated axis along the outer axis, one is found with which the fixture can run all steps."""
    protocol = load_protocol(name)
    assert protocol.states_attitudes is stated
    assert len(protocol.on_fixture()) == len(protocol.steps)


def test_the_axis_along_the_outer_axis_is_found_for_each_placing():
    steps = {"down": "z"}, {"rotations": [["x", 90.0]]}, {"down": "x"}, {"rotations": [["y", 90.0], ["z", -90.0]]}
    assert [(down, outer) for down, outer, _ in protocol(*steps).on_fixture()] == [
        ("z", "x"),
        ("z", "x"),
        ("x", "y"),
        ("x", "y"),
    ]


def protocol(*steps, **main):
    return protocol_from_dict({"step": list(steps), **main}, name="mine")


LEVEL = {"down": "z", "along_outer": "y"}


@pytest.mark.parametrize(
    ("steps", "said"),
    [
        ([{"down": "z"}, {"rotations": [["x", 90.0], ["y", 90.0]]}], r"step 2 .*leave \[fixture\] out"),
        ([{"down": [1.0, 1.0, 0.0], "along_outer": "y"}], "step 1 .*down is not an IMU axis"),
        ([{"down": "x", "along_outer": "z"}], "step 1 .*z is the inner axis"),
        ([{"down": "y", "along_outer": "y"}], "step 1 .*y is vertical"),
        ([LEVEL, {"rotations": [["x", 90.0]]}], r"step 2 .*turn \+90° about x.*neither the inner axis"),
        ([LEVEL, {"rotations": [["z", 45.0]]}, {"rotations": [["z", 45.0]]}], "step 3 .*none lies along the outer"),
        ([LEVEL, {"rotations": [[[1.0, 1.0, 0.0], 90.0]]}], "step 2 .*between those of the IMU"),
    ],
)
def test_a_step_that_no_fixture_can_run_is_named(steps, said):
    with pytest.raises(InputError, match=f"(?i){said}"):
        protocol(*steps).on_fixture()


@pytest.mark.parametrize(
    ("document", "said"),
    [
        ({}, "no step"),
        ({"step": [{"rotations": [["z", 90.0]]}]}, "continues from no pose"),
        ({"step": [{"down": "w"}]}, "step\\[1\\].down"),
        ({"step": [{"down": "z", "rotation": []}]}, "did you mean rotations"),
        ({"step": [{"down": "z", "rotations": [["z", 0.0]]}]}, "not zero"),
        ({"step": [{"down": "z", "turn_s": 3.0}]}, "is a pose"),
        ({"step": [{"id": "1", "down": "z"}]}, "Table 1 defines"),
        ({"step": [{"down": "z", "rotations": [["z", 900.0]], "stated_rate_deg_s": 10.0}]}, "rate_sigma_ppm"),
        (
            {"rate_sigma_ppm": 5.0, "step": [{"down": "z", "rotations": [["z", 9.0]], "stated_rate_deg_s": 99.0}]},
            "less than a third",
        ),
        ({"step": [{"down": "z", "repeat": 0}]}, "repeat"),
        ({"rest_s": -1.0, "step": [{"down": "z"}]}, "rest_s"),
    ],
)
def test_a_malformed_protocol_is_refused_in_one_sentence(document, said):
    with pytest.raises(InputError, match=said) as refused:
        protocol_from_dict(document, name="mine")
    assert "\n" not in str(refused.value)


def test_an_unknown_name_and_too_little_time_are_refused():
    with pytest.raises(InputError, match="did you mean 19-positions"):
        load_protocol("19-position")
    with pytest.raises(InputError, match="leaves no rest"):
        load_protocol("rate-table").lasting(100.0)
