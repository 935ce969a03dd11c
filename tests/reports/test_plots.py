"""Figures: what they hold, that nothing overlaps, and that matplotlib's global state is left alone."""

import subprocess
import sys
from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pytest
from figure_texts import require_readable

import srt
from srt.reports.figures.calibration import calibration_figure, save_figure
from srt.result.calibration import Residual
from srt.sensor_errors import DISPLAY_FACTORS, NAMES

COMPONENTS = ("horizontal_x", "horizontal_y", "start_down", "end_down")


def calibration(turns=17, **changes):
    rng = np.random.default_rng(1)
    factors = np.array(DISPLAY_FACTORS)
    sigma = rng.uniform(0.2, 2.0, 27) / factors
    ids = [f"turn {k + 1}" for k in range(turns)] if turns > 17 else [str(k + 1) for k in range(turns)]
    residuals = tuple(Residual(i, 1, c, float(rng.standard_normal()), 1.0) for i in ids for c in COMPONENTS)
    values = rng.standard_normal(27) * 500.0 / factors
    return replace(
        srt.Calibration("closed-form", "converged", "", srt.SensorErrors(values), np.diag(sigma**2)),
        corrections=(1e-3, 1e-6, 1e-12),
        residuals=residuals,
        **changes,
    )


def held(result, *names):
    covariance = result.covariance.copy()
    for name in names:
        i = NAMES.index(name)
        covariance[i] = covariance[:, i] = 0.0
    return replace(result, covariance=covariance, fixed=dict.fromkeys(names, "held on request"), status="partial")


def panels(figure):
    return [axes for part in figure.subfigs for axes in part.axes]


CASES = {
    "with truth": lambda: calibration_figure(calibration(), truth=srt.SensorErrors(), title="unit"),
    "without truth": lambda: calibration_figure(calibration()),
    "held": lambda: calibration_figure(held(calibration(), "gyro_scale_x", "accel_bias_z")),
    "all of a unit held": lambda: calibration_figure(held(calibration(), *(n for n in NAMES if "gyro_bias" in n))),
    "many turns": lambda: calibration_figure(calibration(turns=120)),
    "long title": lambda: calibration_figure(
        replace(calibration(), status="not_converged"), truth=srt.SensorErrors(), title=f"serial {'M' * 90}"
    ),
    "no residuals": lambda: calibration_figure(calibration(turns=0)),
    "one correction of nothing": lambda: calibration_figure(replace(calibration(), corrections=(0.0,))),
    "no correction": lambda: calibration_figure(replace(calibration(), corrections=())),
}


QUICK = ("with truth", "all of a unit held", "many turns", "no residuals")


@pytest.mark.parametrize("case", [c if c in QUICK else pytest.param(c, marks=pytest.mark.slow) for c in CASES])
def test_texts_neither_overlap_nor_leave_the_figure(case):
    figure = CASES[case]()
    header = figure.subfigs[0]
    titles = [*header.texts, *(text for legend in header.legends for text in legend.get_texts())]
    require_readable(figure, panels(figure), titles, 40)


def test_error_bars_are_one_sigma_in_display_units():
    result = calibration()
    truth = srt.SensorErrors(result.errors.vector * 0.9)
    figure = calibration_figure(result, truth=truth)
    lower = panels(figure)[4:8]
    seen = np.concatenate([axes.containers[0].lines[0].get_ydata() for axes in lower])
    bars = np.concatenate(
        [[np.ptp(segment[:, 1]) / 2 for segment in axes.containers[0].lines[2][0].get_segments()] for axes in lower]
    )
    order = np.argsort([["ppm", "µrad", "µg", "°/h"].index(u) for u in srt.sensor_errors.DISPLAY_UNITS], kind="stable")
    factors = np.array(DISPLAY_FACTORS)
    np.testing.assert_allclose(seen, (0.1 * result.errors.vector * factors)[order], rtol=1e-9)
    np.testing.assert_allclose(bars, (result.sigma * factors)[order], rtol=1e-9)


@pytest.mark.parametrize(("suffix", "magic"), [(".pdf", b"%PDF"), (".svg", b"<?xml")])
def test_files_by_their_ending(tmp_path, suffix, magic):
    figure = calibration_figure(calibration())
    figure.set_layout_engine("none")  # the arrangement of the parts is the same in every format
    save_figure(figure, tmp_path / f"x{suffix}")
    assert (tmp_path / f"x{suffix}").read_bytes().startswith(magic)
    assert len(list(tmp_path.iterdir())) == 1


def test_global_state_is_left_alone():
    before = dict(mpl.rcParams)
    calibration_figure(calibration(), truth=srt.SensorErrors())
    assert dict(mpl.rcParams) == before
    figures = "srt.reports.figures.calibration, srt.reports.figures.inspection"
    code = f"import {figures}, sys; sys.exit('matplotlib.pyplot' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize("figures", ["calibration", "comparison"])
def test_an_absent_matplotlib_says_what_to_install(figures):
    code = (
        "import sys; sys.modules['matplotlib'] = None\n"
        f"import srt\ntry:\n    import srt.reports.figures.{figures}\n"
        "except srt.MissingExtraError as error:\n    print(error)"
    )
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    assert "pip install 'strapdown-rotation-test[plot]'" in done.stdout
