"""Findings of an inspection in simulated and recorded data, and its picture."""

import json
import sys
from dataclasses import replace

import accuracy_trials
import numpy as np
import pytest
import recorded_sets
from figure_texts import require_readable
from matplotlib.backends.backend_agg import FigureCanvasAgg
from scipy.spatial.transform import Rotation

import sims
import srt
from srt.model.table1 import SEQUENCES
from srt.reports.figures.inspection import envelope, inspection_figure
from srt.reports.inspection import inspect
from srt.reports.text.inspection import inspection_report

FOLDER = recorded_sets.data_folder()
RATE = 100.0


def scenario(name, **changes):
    """Give a shipped scenario with parts of its schedule and recording changed."""
    chosen = sims.load_scenario(name)
    update = {
        part: getattr(chosen, part).model_copy(update=values) for part, values in changes.items() if part != "seed"
    }
    return sims.simulate(chosen.model_copy(update=update))


@pytest.fixture(scope="module")
def table_1():
    """Table 1 with labels, 10 s windows, gaps between the sequences."""
    return scenario("tactical-fog", recording={"sample_rate_hz": RATE}).recording


@pytest.fixture(scope="module")
def rested():
    """Two sequences with rests of 60 s, the moves recorded, no labels."""
    schedule = {"sequences": ("1", "13"), "dwell_s": 60.0, "moves": "recorded"}
    kept = {"sample_rate_hz": RATE, "label_sequences": False}
    return scenario("industrial-mems", schedule=schedule, recording=kept).recording


@pytest.fixture(scope="module")
def inspected(table_1):
    return inspect(table_1)


@pytest.fixture(scope="module")
def inspected_rests(rested):
    return inspect(rested)


def still(n=6000, kind="rate", **changes):
    """A unit on a shelf."""
    rng = np.random.default_rng(3)
    factor = 1.0 if kind == "rate" else 1.0 / RATE
    gyro = 1e-4 + 1e-3 * rng.standard_normal((n, 3))
    accel = np.array([0.0, 0.0, 9.80665]) + 1e-2 * rng.standard_normal((n, 3))
    time = np.arange(1, n + 1) / RATE
    return srt.Recording(time, gyro * factor, accel * factor, accuracy_trials.SITE, kind, **changes)


def test_stamps_and_gaps(table_1, inspected):
    stamps = inspected.stamps
    steps = np.diff(table_1.time)
    assert stamps.samples == len(table_1.time)
    assert stamps.rate_hz == pytest.approx(RATE)
    assert stamps.even
    assert stamps.jitter < 1e-6
    assert stamps.gaps == 16
    # A step beside a gap is one interval longer than what is missing.
    assert stamps.missing_s == pytest.approx(steps[steps > 1.5 / RATE].sum() - 16 / RATE, rel=1e-6)
    assert stamps.longest_gap_s == pytest.approx(steps.max() - 1.0 / RATE, rel=1e-6)
    assert stamps.longest_gap_at_s == table_1.time[np.argmax(steps) + 1]
    assert stamps.duration_s == pytest.approx(table_1.time[-1] - table_1.time[0] + 1.0 / RATE)


def test_uneven_stamps_are_told():
    recording = still()
    rng = np.random.default_rng(4)
    shifts = rng.uniform(-0.2, 0.2, len(recording.time)) / RATE
    stamps = inspect(replace(recording, time=recording.time + shifts)).stamps
    assert not stamps.even
    # The difference of two uniform errors of ±0.2 has the standard deviation 0.4/√6; 6000 of them know it to a percent.
    assert stamps.jitter == pytest.approx(0.4 / np.sqrt(6.0), rel=0.06)


def test_rests(inspected, table_1):
    rest = inspected.stillness
    assert len(rest.windows_s) == 34
    # Labelled windows of 10 s end where the turn starts; up to 0.2 s of settling beside them is still, too.
    assert min(rest.lengths_s) > 9.9
    assert max(rest.lengths_s) < 10.5
    low, middle, high = rest.force_g
    # Biases of 5 mg and scale factors of 0.3 % (one sigma) of this unit, six of them.
    assert 0.95 < low <= middle <= high < 1.05
    still_gyro = np.mean([table_1.gyro[table_1.window_indices(a, b)].mean(axis=0) for a, b in rest.windows_s], axis=0)
    assert table_1.kind == "increment"
    np.testing.assert_allclose(rest.rate_deg_per_h, np.degrees(still_gyro) * RATE * 3600.0, rtol=0.02, atol=0.5)


def test_turns_and_what_they_are(inspected):
    assert [turn.sequence for turn in inspected.turns] == list(SEQUENCES)
    assert [turn.labelled for turn in inspected.turns] == list(SEQUENCES)
    for turn in inspected.turns:
        sequence = SEQUENCES[turn.sequence]
        assert [leg.axis for leg in turn.parts] == [axis for axis, _ in sequence.rotations]
        # Scale factors of 1500 ppm, axes out of square by 1 mrad, rotations off by 1 mrad; one sigma each.
        angles = np.degrees([angle for _, angle in sequence.rotations])
        np.testing.assert_allclose([leg.angle_deg for leg in turn.parts], angles, atol=0.005 * 360.0 + 0.5)
        assert turn.fastest_deg_s == pytest.approx(np.degrees(1.0), rel=0.05)
        assert turn.confidence > 0.9


def test_net_rotation_of_a_turn_by_hand():
    simulation = scenario("free-mems", free={"turns": 4, "smallest_turn_deg": 60.0, "largest_turn_deg": 170.0})
    found = inspect(simulation.recording)
    assert len(found.turns) == 4
    assert all(turn.sequence is None for turn in found.turns)
    assert "no fixture" in found.summary
    for turn, (first, second) in zip(found.turns, simulation.windows, strict=True):
        moved = (simulation.motion.time > first[1]) & (simulation.motion.time <= second[0])
        whole = Rotation.identity()
        for step in Rotation.from_rotvec(simulation.motion.angle[moved]):
            whole = whole * step
        expected = whole.as_rotvec(degrees=True)
        vector = np.array(turn.net.direction) * turn.net.angle_deg
        # A consumer unit: 1.5 % of scale factor, 2 % of cross-axis, 2.5 °/s of bias over some 3 s; one sigma each.
        assert np.linalg.norm(vector - expected) < 0.1 * np.linalg.norm(expected) + 3.0 * 2.5 * 3.0


def test_noise_of_short_windows(inspected):
    """10 s windows: no Allan deviation, but the random walk of 34 windows within 3.5 sigma of √(3/m)/2."""
    assert inspected.allan is None
    assert "30 s" in inspected.noise.note
    bound = 3.5 * 0.5 * np.sqrt(3.0 / (34 * 10.0 * RATE)) + 0.02
    for channel, figures in inspected.noise.figures.items():
        key, true = {"g": ("gyro_noise_deg_per_sqrt_h", 0.0667), "a": ("accel_noise_ug_per_sqrt_hz", 60.0)}[channel[0]]
        assert figures[key]["value"] == pytest.approx(true, rel=bound)
    assert inspected.noise.stated["gyro_noise_deg_per_sqrt_h"] == pytest.approx(0.0667)
    assert inspected.noise.stated["accel_range_g"] == 10.0


def test_noise_of_long_windows(inspected_rests):
    found = inspected_rests
    assert found.noise.note is None
    assert found.allan.longest_s > 59.0
    for c, channel in enumerate(found.noise.figures):
        true = 0.15 if c < 3 else 102.0
        figure = next(f for key, f in found.noise.figures[channel].items() if "noise" in key)
        # Intervals of 95 %: three times as far is 6 sigma.
        assert abs(figure["value"] - true) < 3.0 * (figure["high"] - figure["low"]) / 2.0


@pytest.mark.parametrize("kind", ["rate", "increment"])
def test_a_unit_on_a_shelf(kind):
    """One rest and no turn: no refusal of the inspection, and all of the noise."""
    found = inspect(still(kind=kind))
    assert found.turns == ()
    assert len(found.stillness.windows_s) == 1
    assert found.stillness.total_s > 59.0
    assert found.stillness.force_g[1] == pytest.approx(1.0, abs=1e-3)
    assert found.allan is not None
    assert "two are needed, with a turn between them" in found.summary
    # 1e-3 rad/s per sample at 100 Hz.
    assert found.allan.value[0, 1] == pytest.approx(1e-4, rel=0.05)


def test_no_rest_at_all():
    rng = np.random.default_rng(5)
    n = 3000
    time = np.arange(1, n + 1) / RATE
    sway = np.cumsum(rng.standard_normal((n, 3)), axis=0) * 0.1
    recording = srt.Recording(time, sway, 9.8 + sway, accuracy_trials.SITE)
    found = inspect(recording)
    json.dumps(found.as_dict(), allow_nan=False)
    assert found.turns == () or found.stillness is not None
    FigureCanvasAgg(inspection_figure(recording, found)).draw()


def test_two_samples():
    recording = srt.Recording(np.array([0.0, 0.01]), np.zeros((2, 3)), np.full((2, 3), 5.0), accuracy_trials.SITE)
    found = inspect(recording)
    assert found.stillness is None
    assert found.noise is None
    assert found.turns == ()
    json.dumps(found.as_dict(), allow_nan=False)
    FigureCanvasAgg(inspection_figure(recording, found)).draw()


def test_stamps_in_another_unit_than_declared():
    """A recording with a sample every second is not searched for windows, but its figures are given."""
    recording = still()
    found = inspect(replace(recording, time=recording.time * RATE))
    assert found.stillness is None
    assert found.stamps.rate_hz == pytest.approx(1.0)
    assert "time_unit" in found.summary
    assert found.diagnosis.refusal.fault == "time_unit"


def test_temperature():
    n = 6000
    assert inspect(still()).temperature is None
    stated = inspect(still(temperature=np.broadcast_to(25.0, n))).temperature
    assert (stated.recorded, stated.lowest_c, stated.highest_c) == (False, 25.0, 25.0)
    ramp = np.linspace(20.0, 21.0, n)
    seen = inspect(still(temperature=ramp)).temperature
    assert (seen.recorded, seen.first_c, seen.last_c, seen.lowest_c, seen.highest_c) == (True, 20.0, 21.0, 20.0, 21.0)


def test_faults_that_only_a_calibration_shows_are_told(inspected):
    assert inspected.not_looked_for == ("gyro_factor", "accel_factor", "accel_bias_drift", "asymmetry_omitted")
    assert inspected.as_dict()["not_looked_for"] == list(inspected.not_looked_for)
    assert f"(--deep): {', '.join(inspected.not_looked_for)}." in " ".join(inspection_report(inspected).split())
    assert replace(inspected, calibrated=True).not_looked_for == ()


def test_without_allantools_the_short_figures_stand_in(monkeypatch):
    monkeypatch.setitem(sys.modules, "allantools", None)
    found = inspect(still())
    assert found.allan is None
    assert "pip install 'strapdown-rotation-test[allan]'" in found.noise.note
    # 1e-3 rad/s per sample at 100 Hz is 1e-4 rad/√s; 6000 samples know it to 3 %, at 3.5 sigma.
    figure = found.noise.figures["gyro_x"]["gyro_noise_deg_per_sqrt_h"]["value"]
    assert figure == pytest.approx(np.degrees(1e-4) * 60.0, rel=0.05)


def test_the_envelope_keeps_extremes_and_breaks():
    rng = np.random.default_rng(6)
    time = np.arange(100_000) * 0.01
    values = rng.standard_normal((100_000, 3))
    values[54_321, 1] = 99.0
    at, drawn = envelope(time, values, np.array([40_000]))
    assert len(at) == len(drawn) < 4000
    for extreme in (np.nanmin, np.nanmax):
        np.testing.assert_array_equal(extreme(drawn, axis=0), extreme(values, axis=0))
    assert np.isnan(drawn).all(axis=1).sum() == 1
    assert np.all(np.diff(at) >= 0.0)
    spike = at[np.nanargmax(drawn[:, 1])]
    assert abs(spike - time[54_321]) < 1.0
    short = envelope(time[:50], values[:50], np.zeros(0, dtype=np.intp))
    np.testing.assert_array_equal(short[1], values[:50])


CASES = {
    "labelled": ("table_1", "inspected"),
    "with Allan deviation": ("rested", "inspected_rests"),
}


@pytest.mark.parametrize("case", CASES)
def test_texts_neither_overlap_nor_leave_the_figure(case, request):
    figure = inspection_figure(*map(request.getfixturevalue, CASES[case]), title="unit")
    require_readable(figure, figure.axes, [figure._suptitle, *figure.legends[0].get_texts()], 20)


def test_the_picture_shows_rests_sequences_and_slopes(rested, inspected_rests):
    found = inspected_rests
    figure = inspection_figure(rested, found)
    assert len(figure.axes) == 4
    rates = figure.axes[0]
    assert {text.get_text() for text in rates.texts} == {"1", "13"}
    assert len(rates.collections[0].get_paths()) == len(found.stillness.windows_s)
    slopes = [text.get_text() for text in figure.axes[1].get_legend().get_texts()]
    assert any(text.startswith("random walk 0.1") for text in slopes)  # 0.15 °/√h


@pytest.mark.skipif(
    FOLDER is None, reason=f"recorded sets not found; set {recorded_sets.DATA_VARIABLE} to their folder"
)
def test_recorded_sets():
    """Motion as the authors describe it: 37 rotations of the MTi, 21 of the MPU-9150; six faces, three full turns."""
    turns = {}
    for name, recording in (
        ("xsens", recorded_sets.xsens_mti(FOLDER)),
        ("mpu9150", recorded_sets.mpu9150(FOLDER, 0)),
        ("ferraris", recorded_sets.ferraris(FOLDER)),
    ):
        found = inspect(recording)
        assert found.diagnosis.refusal is None, name
        assert all(turn.sequence is None for turn in found.turns), name
        json.dumps(found.as_dict(), allow_nan=False)
        FigureCanvasAgg(inspection_figure(recording, found, title=name)).draw()
        turns[name] = found.turns
    assert len(turns["xsens"]) in range(36, 42)
    assert len(turns["mpu9150"]) == 21
    full = [
        turn.parts[0] for turn in turns["ferraris"] if len(turn.parts) == 1 and abs(turn.parts[0].angle_deg) > 300.0
    ]
    assert [leg.axis for leg in full] == ["x", "y", "z"]
    # Four quarter turns by hand against a ruler.
    np.testing.assert_allclose([abs(leg.angle_deg) for leg in full], 360.0, atol=20.0)
