"""Units of the parameters in a report: one for each group, the same in text, certificate and figure."""

from dataclasses import replace

import numpy as np
import pytest
from certificate_cases import calibration as made_up
from certificate_cases import saved_calibration

import srt
from srt.reports.certificate import load_acceptance_limits, make_certificate
from srt.reports.figures.calibration import calibration_figure
from srt.reports.text.calibration import report
from srt.sensor_errors import GROUP_SLICES, NAMES

LARGE = {"gyro_bias": (-3.81, "°/s", np.radians(1.0)), "accel_bias": (124.65, "mg", 9.80665e-3)}
"""Value of one parameter, its unit, and that in SI, of a MEMS unit."""


@pytest.fixture(params=[*LARGE, None])
def case(request):
    """A calibration whose first parameter of one group is large, and the units of its two groups of biases."""
    units = {"gyro_bias": "°/h", "accel_bias": "µg"}
    calibration = replace(made_up(), contributions={"gyro_noise": np.full(27, 1e-6)})
    vector = np.where(np.arange(27) == 0, 0.3, 1e-6)  # a scale factor stays in ppm
    if request.param is not None:
        value, unit, si = LARGE[request.param]
        vector[GROUP_SLICES[request.param].start] = value * si
        units[request.param] = unit
    return replace(calibration, errors=srt.SensorErrors(vector)), units


def test_a_large_bias_has_its_group_in_the_unit_of_its_grade_everywhere(case, tmp_path):
    calibration, units = case
    lines = [line.split() for line in report(calibration, title="", verdict=True).splitlines()]
    table = {cells[1]: cells for cells in lines if len(cells) == 5 and cells[1] in NAMES}
    made = make_certificate(saved_calibration(tmp_path, calibration))
    cells = dict(zip(NAMES, made.parameters.texts, strict=True))
    assert table["gyro_scale_x"][4] == cells["gyro_scale_x"][5] == "ppm"
    for group, unit in units.items():
        names = NAMES[GROUP_SLICES[group]]
        assert {table[name][4] for name in names} == {cells[name][5] for name in names} == {unit}
        for name in names:
            assert (table[name][2], table[name][3]) == (cells[name][2], cells[name][3])
        (budget,) = [row for row in made.budget.texts if row[0] == group.replace("_", " ")]
        assert budget[1] == unit
    titles = [axes.get_title(loc="left") for axes in calibration_figure(calibration).subfigs[1].axes]
    assert f"gyro bias, {units['gyro_bias']}" in titles
    assert f"accel. bias, {units['accel_bias']}" in titles
    if "°/s" in units.values():
        assert float(table["gyro_bias_x"][2]) == pytest.approx(-3.81, abs=1e-4)
    if "mg" in units.values():
        assert float(table["accel_bias_x"][2]) == pytest.approx(124.65, abs=1e-3)


def test_limits_are_entered_in_the_units_of_their_keys_and_shown_in_those_of_the_table(tmp_path):
    vector = np.zeros(27)
    vector[GROUP_SLICES["gyro_bias"]] = np.radians([1.0, 2.0, 3.0])
    calibration = replace(made_up(), errors=srt.SensorErrors(vector))
    (tmp_path / "limits.toml").write_text("[value]\ngyro_bias_deg_per_h = 9000\n")
    made = make_certificate(
        saved_calibration(tmp_path, calibration), limits=load_acceptance_limits(tmp_path / "limits.toml")
    )
    assert [row[6:] for row in made.parameters.texts[-3:]] == [
        [result, "|value| ≤ 2.5"] for result in ("passed", "passed", "failed")
    ]  # fmt: skip
    assert made.failed == ("gyro_bias_z",)
