"""Poses alone and stated rates as measurements: exact solutions, errors against their sigmas, and what is not seen."""

import numpy as np
import protocols
import pytest
from scipy.stats import chi2

import sims
import srt
from sims.scenarios.scenario import scenario_from_dict
from srt.estimation.iterations import CONVERGED_SIGMAS
from srt.recording.recording import Fixture
from srt.sensor_errors import GROUP_SLICES, INDEX

G = 9.80665
RATE_HZ = 50.0
POSE_S = 4.0
NO_ASYMMETRY = ("gyro_asymmetry", "accel_asymmetry")
FACES = {"z": "y", "-z": "y", "x": "y", "-x": "y", "y": "x", "-y": "x"}
"""IMU axis down, and IMU axis along the outer axis."""


def down_vector(axis: str) -> np.ndarray:
    out = np.zeros(3)
    out["xyz".index(axis[-1])] = -1.0 if axis.startswith("-") else 1.0
    return out


def tumble(Ma, bias, *, sigma=0.0, fixture=None, rng=None, downs=None) -> srt.Recording:
    """Recording of poses, written out: readings Ma f + bias; the gyros read nothing but noise, on a still Earth."""
    rng = rng or np.random.default_rng(0)
    n = round(POSE_S * RATE_HZ)
    time, accel, labels = [], [], []
    for k, down in enumerate(map(down_vector, FACES) if downs is None else downs):
        start = k * (POSE_S + 5.0)
        time.append(start + np.arange(1, n + 1) / RATE_HZ)
        accel.append(-G * (Ma @ down) + bias + sigma * rng.standard_normal((n, 3)))
        axes = () if fixture is None else (None, *list(FACES.items())[k])
        labels.append(srt.SequenceLabel.of_pose((start, start + POSE_S), *axes))
    gyro = 1e-9 * rng.standard_normal((n * len(time), 3))
    site = srt.Site(G, latitude_rad=None)
    # White noise is stated to be all, so that every pose has the same weight.
    noise = srt.ImuNoise(gyro_bias_instability=0.0, accel_bias_instability=0.0)
    return srt.Recording(
        np.concatenate(time), gyro, np.concatenate(accel), site, fixture=fixture, noise=noise, sequences=tuple(labels)
    )


MA = np.eye(3) + np.array([[2e-3, 8e-4, -5e-4], [3e-4, -1e-3, 6e-4], [-7e-4, 4e-4, 1.5e-3]])
BIAS = np.array([0.02, -0.03, 0.05])


def halves(recording, axis: str) -> np.ndarray:
    """Mean reading of a pose from its two halves, which leave out the moment between them."""
    k = list(FACES).index(axis)
    label = recording.sequences[k]
    windows = (label.start_static_s, label.end_static_s)
    return np.mean([recording.accel[recording.window_indices(*w)].mean(axis=0) for w in windows], axis=0)


@pytest.mark.parametrize("sigma", [0.0, 1e-3])
def test_six_faces_on_a_fixture_are_the_mean_differences(sigma):
    """The exact solution of six faces: half sums give biases, half differences the columns of Ma."""
    recording = tumble(MA, BIAS, sigma=sigma, fixture=Fixture(0.0, 1e-3, 1e-3))
    found = srt.calibrate(recording, "least-squares", checks=False, hold=NO_ASYMMETRY)
    columns = [(halves(recording, axis) - halves(recording, f"-{axis}")) / (-2.0 * G) for axis in "xyz"]
    exact = np.stack(columns, axis=1)
    # Of an own axis, the two poses along it are exact whatever the fixture; they give its bias.
    bias = [0.5 * (halves(recording, axis) + halves(recording, f"-{axis}"))[i] for i, axis in enumerate("xyz")]
    # The iteration ends within 0.01 sigma. With noise, the poses across an axis have a small weight in its bias: noise
    # over the inclination of the fixture, squared. Directions are weighted by the errors that the poses share, which
    # changes a misalignment by up to the noise of a pose.
    noise = sigma / np.sqrt(POSE_S * RATE_HZ) / G
    for i, axis in enumerate("xyz"):
        scale, offset = INDEX[f"accel_scale_{axis}"], INDEX[f"accel_bias_{axis}"]
        bound = 6.0 * noise * (noise / 1e-3) ** 2 + CONVERGED_SIGMAS * found.sigma[scale]
        assert found.errors.vector[scale] == pytest.approx(exact[i, i] - 1.0, abs=bound)
        bound = 6.0 * noise * (noise / 1e-3) ** 2 + CONVERGED_SIGMAS * found.sigma[offset] / G
        assert found.errors.vector[offset] == pytest.approx(bias[i], abs=G * bound)
        for j, other in enumerate("xyz"):
            if i != j:
                across = INDEX[f"accel_misalignment_{axis}{other}"]
                bound = 3.5 * noise + CONVERGED_SIGMAS * found.sigma[across]
                assert found.errors.vector[across] == pytest.approx(exact[i, j], abs=bound)


def test_six_faces_without_a_fixture_are_the_mean_differences_of_orthogonal_axes():
    recording = tumble(np.diag([1.002, 0.999, 1.0015]), BIAS)
    found = srt.calibrate(recording, "least-squares", checks=False, hold=NO_ASYMMETRY)
    for i, axis in enumerate("xyz"):
        up, down = halves(recording, f"-{axis}")[i], halves(recording, axis)[i]
        scale, offset = INDEX[f"accel_scale_{axis}"], INDEX[f"accel_bias_{axis}"]
        # The iteration ends within 0.01 sigma.
        allowed = CONVERGED_SIGMAS * found.sigma
        assert found.errors.vector[offset] == pytest.approx(0.5 * (up + down), abs=allowed[offset])
        # The biases of the other axes incline each reading; the magnitude includes them, the difference does not.
        assert found.errors.vector[scale] == pytest.approx(0.5 * (up - down) / G - 1.0, abs=allowed[scale])


def oblique(count: int) -> list[np.ndarray]:
    eye = np.eye(3)
    turn = np.linspace(0.0, 2.0 * np.pi, count // 3, endpoint=False)
    return [np.cos(a) * eye[i] + np.sin(a) * eye[j] for i, j in ((0, 1), (1, 2), (2, 0)) for a in turn]


def test_24_faces_give_the_triad_in_its_own_axes():
    """Gravity's magnitude determines MaᵀMa: found is the lower triangle with the same, biases as they are."""
    asymmetry = np.array([1e-3, -5e-4, 2e-4])
    recording = tumble(MA, BIAS, downs=oblique(24))
    readings = recording.accel - BIAS
    f = np.linalg.solve(MA, readings.T).T
    recording = srt.Recording(
        recording.time, recording.gyro, recording.accel + asymmetry * np.abs(f), recording.site,
        sequences=recording.sequences,
    )  # fmt: skip
    found = srt.calibrate(recording, "least-squares", checks=False)
    # Rows of Ma in other orthogonal axes: their lengths and angles remain.
    lower = np.linalg.cholesky(MA @ MA.T)
    for i, a in enumerate("xyz"):
        assert found.errors[f"accel_bias_{a}"] == pytest.approx(BIAS[i], abs=1e-6 * G)
        assert found.errors[f"accel_scale_{a}"] == pytest.approx(lower[i, i] - 1.0, abs=2e-6)
        assert found.errors[f"accel_asymmetry_{a}"] == pytest.approx(asymmetry[i], abs=2e-6)
        for j, b in enumerate("xyz"):
            if i > j:
                assert found.errors[f"accel_misalignment_{a}{b}"] == pytest.approx(lower[i, j], abs=2e-6)
            elif i < j:
                assert "by definition of the axes" in found.fixed[f"accel_misalignment_{a}{b}"]


def scenario(name: str, seed: int, **tables):
    base = {
        "seed": seed,
        "imu": {"from": "tactical-fog"},
        "site": {"from": "latitude-45"},
        "protocol": {"from": name},
        "recording": {"sample_rate_hz": 20.0},
    }
    return scenario_from_dict(base | tables)


@pytest.mark.parametrize("units", [6, pytest.param(60, marks=pytest.mark.campaign)])
@pytest.mark.parametrize("name", ["24-face-tumble", "rate-table"])
def test_errors_agree_with_their_sigmas(name, units):
    """NEES of the parameters that do not depend on the choice of axes, family-wise 1 %."""
    names = [
        *(f"accel_bias_{a}" for a in "xyz"),
        *([f"accel_asymmetry_{a}" for a in "xyz"] if name != "rate-table" else []),
        *([f"gyro_asymmetry_{a}" for a in "xyz"] if name == "rate-table" else []),
    ]
    at = [INDEX[n] for n in names]
    total = 0.0
    for seed in range(units):
        simulation = sims.simulate(scenario(name, seed))
        found = srt.calibrate(simulation.recording, "least-squares", checks=False)
        assert found.status == "partial", found.message
        assert not any("larger than" in warning for warning in found.warnings), found.warnings
        off = (found.errors.vector - simulation.truth.vector)[at]
        total += float(off @ np.linalg.solve(found.covariance[np.ix_(at, at)], off))
    if name == "24-face-tumble":
        assert chi2.ppf(0.0025, units * len(at)) < total
    assert total < chi2.ppf(0.9975, units * len(at))  # sigmas of the rate table include priors of fixed parameters


def test_a_stated_rate_gives_the_scale_that_the_rotation_test_cannot_see():
    """About the vertical, gravity shows no rotation; the stated rate does, with its own sigma."""
    simulation = sims.simulate(scenario("rate-table", 1))
    recording = simulation.recording
    stated = srt.calibrate(recording, "least-squares", checks=False)
    scale = GROUP_SLICES["gyro_scale"]
    assert stated.observed[scale].all()
    assert np.all(stated.sigma[scale] > 20e-6)  # the sigma of the table, common to all runs
    off = (stated.errors.vector - simulation.truth.vector)[scale]
    assert np.all(np.abs(off) < 4.0 * stated.sigma[scale])
    common = stated.covariance[scale, scale]
    assert np.min(common[~np.eye(3, dtype=bool)]) > 0.9 * (20e-6) ** 2
    plain = tuple(srt.SequenceLabel(s.start_static_s, s.end_static_s) for s in recording.sequences if not s.pose)
    without = srt.calibrate(recording.with_sequences(plain), "least-squares", checks=False)
    assert not without.observed[scale].all()
    assert "stated rate about" in "".join(without.fixed.values())


def test_a_rate_of_the_wrong_sense_is_refused():
    recording = sims.simulate(scenario("rate-table", 1)).recording
    runs = [label for label in recording.sequences if label.rate is not None]
    turned = [srt.SequenceLabel(r.start_static_s, r.end_static_s, rate=(r.rate[0], -r.rate[1]), rate_sigma=1e-5,
                                steady_s=r.steady_s) for r in runs]  # fmt: skip
    with pytest.raises(srt.exceptions.DataError, match="the gyros read"):
        srt.calibrate(recording.with_sequences(tuple(turned)), "least-squares", checks=False)


def test_unobservable_parameters_are_named_with_the_missing_data():
    recording = tumble(np.diag([1.002, 0.999, 1.0015]), BIAS)
    found = srt.calibrate(recording, "least-squares", checks=False, hold=("accel_asymmetry",))
    assert "add a rotation about the axis" in found.fixed["gyro_scale_x"]
    assert "poses between them" in found.fixed["accel_misalignment_yx"]
    upright = recording.with_sequences(recording.sequences[:2])  # z down and z up
    found = srt.calibrate(upright, "least-squares", checks=False, hold=("accel_asymmetry",))
    assert "add poses with the axis up" in found.fixed["accel_bias_x"]


def test_parameters_known_better_from_the_fixture_keep_their_values():
    """Ferraris' poses and turns on a fixture of 1 mrad: gravity does not show misalignments, the fixture does."""
    simulation = sims.simulate(
        scenario("ferraris", 4, fixture={"from": "lab-1mrad"}, recording={"sample_rate_hz": 100.0})
    )
    found = srt.calibrate(simulation.recording, "least-squares", checks=False, hold=NO_ASYMMETRY)
    assert found.status == "partial", found.message
    off = np.abs(found.errors.vector - simulation.truth.vector)
    for group in ("gyro_orthogonality", "accel_misalignment"):
        at = GROUP_SLICES[group]
        assert not found.observed[at].any()
        # Levelling, mounting and two angles of 1 mrad each, twice in a non-orthogonality.
        assert np.all(off[at] < 2.0 * 3.5 * np.sqrt(4.0) * 1e-3)
    assert found.observed[GROUP_SLICES["accel_scale"]].all()


@pytest.mark.parametrize(("protocol", "seed"), [("ferraris", 70006), ("7-positions", 70010)])
def test_directions_that_a_protocol_hardly_shows_do_not_keep_it_from_converging(protocol, seed):
    """Ferraris' turns without a fixture show one gyro angle to 0.6 rad, so that it is fixed; 7 positions to 0.05 rad.

    The unknown Earth rate, which depends on these angles, has converged when it changes by less than its noise.
    """
    score = protocols.by_protocol((protocol, "fixed"), seed - protocols.FIRST_SEED, ["least-squares"])["least-squares"]
    assert score.status == "partial"
    assert np.all(np.isfinite(score.error[GROUP_SLICES["gyro_scale"]]))


def test_misalignments_whose_squares_count_are_not_observed():
    """Ferraris' turns without a fixture: 20 mrad beside 5e-6; NEES of thousands if they count as observed.

    A third of the units does not converge, and has no values.
    """
    scores = [
        protocols.by_protocol(("ferraris", "fixed"), unit, ["least-squares"])["least-squares"] for unit in range(6)
    ]
    scores = [score for score in scores if score.status == "partial"]
    assert len(scores) > 1
    # The sigmas hold what the fixed misalignments may be: an upper limit, 1 %.
    assert sum(score.nees for score in scores) < chi2.ppf(0.99, sum(score.freedom for score in scores))


@pytest.mark.parametrize("name", ["24-face-tumble", "six-face-tumble", "rate-table"])
def test_joint_estimators_agree_on_poses_and_rates(name):
    """The same parameters fixed, the same errors of the others, and no scale factor from the Earth's rate alone."""
    pytest.importorskip("gtsam")
    recording = sims.simulate(scenario(name, 1)).recording
    least, *joint = (srt.calibrate(recording, name, checks=False) for name in ("least-squares", "ekf", "graph"))
    at = np.r_[GROUP_SLICES["accel_bias"], GROUP_SLICES["accel_scale"], GROUP_SLICES["accel_asymmetry"]]
    at = at[least.observed[at]]
    for found in joint:
        np.testing.assert_array_equal(found.observed, least.observed)
        np.testing.assert_allclose(found.sigma[at], least.sigma[at], rtol=0.02)
        # Least squares uses the mean rate of all poses, the others the rate of each: 0.1 sigma of what it shows.
        assert np.all(np.abs(found.errors.vector - least.errors.vector)[at] < 0.1 * least.sigma[at])
        if name != "rate-table":
            assert not found.observed[GROUP_SLICES["gyro_scale"]].any()
            assert "add a rotation" in found.fixed["gyro_scale_x"]
