"""Several recordings of one unit merged: the values, what is common to recordings, and what differs between them."""

from dataclasses import replace
from functools import cache

import accuracy_trials
import numpy as np
import pytest
from scipy.special import chdtri
from scipy.stats import kstest
from small_units import on_fixture

import srt
from sims.physics.imu import read_out
from srt.comparison.merge import merge_calibrations
from srt.comparison.merge_model import between_sigma, stack_estimates
from srt.constants import DEG_PER_H
from srt.reports.text.repeatability import repeatability_text
from srt.result.noise_figures import NoiseFigures
from srt.result.provenance import Provenance, StatedSite, Temperature
from srt.result.repeatability import OmittedRecording
from srt.sensor_errors import GROUP_SLICES, INDEX, N_PARAMETERS, NAMES, SensorErrors

TAIL = 2.3e-4
"""Probability beyond 3.5 standard errors of a normal distribution, on each side."""

SCALE = GROUP_SLICES["accel_scale"]


def made(vector, covariance, held=(), **changes):
    """A calibration with given values, as an estimator would make it."""
    observed = np.array([name not in held for name in NAMES])
    fields = {
        "estimator": "x",
        "status": "partial" if held else "converged",
        "message": "",
        "errors": SensorErrors(vector),
        "covariance": np.where(np.outer(observed, observed), covariance, 0.0),
        "fixed": dict.fromkeys(held, "not shown"),
        "site": StatedSite(gravity_m_s2=9.80665),
        "provenance": Provenance(serial="SN-1"),
    }
    return srt.Calibration(**(fields | changes))


def random_covariance(rng, size=1e-6):
    root = size * rng.standard_normal((N_PARAMETERS, 2 * N_PARAMETERS))
    return root @ root.T


# Linear problems: the joint least-squares solution


def recorded(rng, x, columns, rows=60):
    """White measurements of some of the parameters: their Jacobian and values."""
    H = 1e6 * rng.standard_normal((rows, len(columns)))
    return H, H @ x[columns] + rng.standard_normal(rows)


def alone(H, z):
    P = np.linalg.inv(H.T @ H)
    return P @ H.T @ z, P


@pytest.mark.parametrize("held", [(), ("gyro_asymmetry_y", "accel_bias_z")], ids=["all", "two held in one"])
def test_merged_is_the_joint_least_squares_solution(held):
    """Three recordings of 60 measurements, or all 180 at once; a held parameter comes from those that observe it.

    Rounding: normal matrices of condition below 1e3.
    """
    rng = np.random.default_rng(1)
    x = 1e-3 * rng.standard_normal(N_PARAMETERS)
    x[[INDEX[name] for name in held]] = 0.0  # so that the one recording is right to take them for zero
    calibrations, H, z = [], [], []
    for names in ((), held, ()):
        columns = np.array([i for i, name in enumerate(NAMES) if name not in names])
        part, values = recorded(rng, x, columns)
        found, P = alone(part, values)
        vector, covariance = np.zeros(N_PARAMETERS), np.zeros((N_PARAMETERS, N_PARAMETERS))
        vector[columns], covariance[np.ix_(columns, columns)] = found, P
        calibrations.append(made(vector, covariance, names))
        H.append(np.zeros((60, N_PARAMETERS)))
        H[-1][:, columns] = part
        z.append(values)
    joint, P = alone(np.concatenate(H), np.concatenate(z))
    merged = merge_calibrations(calibrations, between=False)
    np.testing.assert_allclose(merged.errors.vector, joint, rtol=0.0, atol=1e-9 * np.abs(joint).max())
    np.testing.assert_allclose(merged.covariance, P, rtol=1e-9, atol=1e-12 * np.diag(P).max())
    assert merged.status == "converged"
    assert merged.fixed == {}
    assert merged.estimator == "merged"
    # The joint solution's chi-square is that within the recordings and that between them.
    within = sum(float(np.sum((v - h @ c.errors.vector) ** 2)) for h, v, c in zip(H, z, calibrations, strict=True))
    whole = float(np.sum((np.concatenate(z) - np.concatenate(H) @ joint) ** 2))
    table = merged.diagnostics.repeatability
    assert table.chi_square == pytest.approx(whole - within, rel=1e-8)
    assert table.degrees_of_freedom == 3 * N_PARAMETERS - len(held) - N_PARAMETERS


def test_common_gravity_is_an_unknown_of_all_recordings():
    """Gravity known to its sigma, as one more unknown of the joint problem: same values, same covariance."""
    rng = np.random.default_rng(2)
    x = 1e-3 * rng.standard_normal(N_PARAMETERS)
    effect = np.zeros(N_PARAMETERS)
    effect[SCALE] = 5e-7
    calibrations, H, z = [], [], []
    for _ in range(3):
        # Any other gravity looks like other scales, so that nothing in a recording tells of it.
        part, values = recorded(rng, x + 1.3 * effect, np.arange(N_PARAMETERS))
        found, P = alone(part, values)
        calibrations.append(made(found, P + np.outer(effect, effect), noise=NoiseFigures(gravity_effect=effect)))
        H.append(np.column_stack([part, part @ effect]))
        z.append(values)
    prior = np.eye(1, N_PARAMETERS + 1, N_PARAMETERS)
    joint, P = alone(np.concatenate([*H, prior]), np.concatenate([*z, [0.0]]))
    merged = merge_calibrations(calibrations, between=False)
    np.testing.assert_allclose(merged.errors.vector, joint[:-1], rtol=0.0, atol=1e-9 * np.abs(joint).max())
    np.testing.assert_allclose(merged.covariance, P[:-1, :-1], rtol=1e-8, atol=1e-11 * np.diag(P)[:-1].max())
    np.testing.assert_allclose(merged.contributions["gravity"], effect, atol=1e-15)


def test_common_errors_are_not_averaged_down():
    """16 recordings with equal sigmas leave a sixteenth of their own variance and all of the common one."""
    rng = np.random.default_rng(3)
    own = random_covariance(rng)
    effect, by_held = np.zeros(N_PARAMETERS), np.zeros((N_PARAMETERS, N_PARAMETERS))
    effect[SCALE] = 1e-5
    shift = 1e-5 * rng.standard_normal((N_PARAMETERS, 2))
    by_held = shift @ shift.T
    noise = NoiseFigures(gravity_effect=effect, held_values_covariance=by_held)
    calibrations = [
        made(1e-3 * rng.standard_normal(N_PARAMETERS), own + by_held + np.outer(effect, effect), noise=noise)
        for _ in range(16)
    ]
    merged = merge_calibrations(calibrations, between=False)
    expected = own / 16.0 + by_held + np.outer(effect, effect)
    np.testing.assert_allclose(merged.covariance, expected, rtol=1e-6, atol=1e-9 * np.diag(expected).max())
    elsewhere = [replace(c, site=StatedSite(gravity_m_s2=9.8 + 1e-3 * n)) for n, c in enumerate(calibrations)]
    apart = merge_calibrations(elsewhere, between=False)
    expected = own / 16.0 + by_held + np.outer(effect, effect) / 16.0
    np.testing.assert_allclose(apart.covariance, expected, rtol=1e-6, atol=1e-9 * np.diag(expected).max())
    assert any("The stated gravity differs" in w for w in apart.warnings)


def test_contributions_add_up_to_sigma():
    rng = np.random.default_rng(4)
    calibrations = [made(1e-4 * rng.standard_normal(N_PARAMETERS), random_covariance(rng)) for _ in range(3)]
    merged = merge_calibrations(calibrations)
    assert max(merged.noise.between_recordings.values()) > 0.0
    total = np.sqrt(sum(part**2 for part in merged.contributions.values()))
    np.testing.assert_allclose(total, merged.sigma, rtol=1e-9)


def test_sigmas_of_before_know_gravity_by_its_size_alone():
    """A file without the effect's signs: gravity is taken to move the three scales alike, which it does."""
    first, second = (calibrations_of(1)[i] for i in (0, 1))
    merged = merge_calibrations([first, second], between=False)

    def bare(c):
        return replace(c, noise=replace(c.noise, gravity_effect=None))

    old = merge_calibrations([bare(first), bare(second)], between=False)
    np.testing.assert_allclose(old.sigma[SCALE], merged.sigma[SCALE], rtol=1e-3)


# Between recordings


def test_turn_on_scatter_is_found():
    """Biases that differ by ten of their sigmas between recordings: the mean of the estimated variance is true.

    Three recordings and three axes leave six degrees of freedom for a variance: its relative variance is 2 / 6 for a
    unit, and the mean over units is normal to a skewness of √(8/6)/√30.
    """
    rng = np.random.default_rng(5)
    units, tau = 30, 1e-5
    P = random_covariance(rng, 1e-7)
    group = GROUP_SLICES["gyro_bias"]
    found = []
    for _ in range(units):
        values = rng.multivariate_normal(np.zeros(N_PARAMETERS), P, size=3, method="eigh")
        values[:, group] += tau * rng.standard_normal((3, 3))
        found.append(between_sigma(stack_estimates([made(v, P) for v in values])))
    variance = np.mean(np.square(found), axis=0)
    at = list(GROUP_SLICES).index("gyro_bias")
    # Beside the scatter itself, what the sigmas within add is a hundredth of a percent.
    assert variance[at] / tau**2 == pytest.approx(1.0, abs=3.5 * np.sqrt(2.0 / 6.0 / units) + 1e-2)
    others = np.delete(np.sqrt(variance), at)
    assert others.max() < np.sqrt(np.diag(P).max())


def test_turn_on_scatter_is_in_the_covariance():
    """Sigma of the mean of n turn-ons is τ/√n, and the other groups keep theirs."""
    rng = np.random.default_rng(6)
    P = np.diag(np.full(N_PARAMETERS, 1e-14))
    values = np.zeros((4, N_PARAMETERS))
    values[:, GROUP_SLICES["accel_bias"]] = 1e-4 * rng.standard_normal((4, 3))
    merged = merge_calibrations([made(v, P) for v in values])
    tau = merged.noise.between_recordings["accel_bias"]
    np.testing.assert_allclose(merged.sigma[GROUP_SLICES["accel_bias"]], np.hypot(tau, 1e-7) / 2.0, rtol=1e-6)
    np.testing.assert_allclose(merged.sigma[GROUP_SLICES["gyro_scale"]], 0.5e-7, rtol=1e-6)
    assert merged.noise.between_recordings["gyro_scale"] == 0.0
    assert any("accel bias from recording to recording" in w for w in merged.warnings)


def test_a_recording_that_differs_stands_out():
    rng = np.random.default_rng(7)
    P = random_covariance(rng, 1e-7)
    values = rng.multivariate_normal(np.zeros(N_PARAMETERS), P, size=4, method="eigh")
    i = INDEX["gyro_scale_y"]
    values[2, i] += 20.0 * np.sqrt(P[i, i])
    merged = merge_calibrations([made(v, P) for v in values], ["a", "b", "c", "d"])
    worst = max(merged.consistency.sequences, key=lambda row: row.chi_square)
    assert worst.sequence == "c"
    row = merged.diagnostics.repeatability.parameters[i]
    assert row.largest_deviation.recording == "c"
    # 20 of a sigma, and what is left of a value from the mean of four has three quarters of its variance.
    expected = (values[2, i] - values[:, i].mean()) / np.sqrt(0.75 * P[i, i])
    assert row.largest_deviation.sigmas == pytest.approx(expected, rel=1e-6)
    assert row.spread == pytest.approx(np.std(values[:, i], ddof=1))
    assert row.probability < 1e-6
    assert any("differ by more than their sigmas explain" in w for w in merged.warnings)


def test_of_two_recordings_that_deviate_alike_the_first_is_named():
    rng = np.random.default_rng(8)
    covariances = [random_covariance(rng), random_covariance(rng)]
    values = [rng.multivariate_normal(np.zeros(N_PARAMETERS), P, method="eigh") for P in covariances]
    merged = merge_calibrations([made(*own) for own in zip(values, covariances, strict=True)], ["a", "b"])
    rows = merged.diagnostics.repeatability.parameters
    assert {row.largest_deviation.recording for row in rows} == {"a"}


# Simulated units


def recordings(seed, count=3):
    """One unit in several recordings: gravity is the same, fixture and noise are new in each."""
    rng = np.random.default_rng(seed)
    truth = accuracy_trials.normal_errors(rng, 1e-3, 10.0 * DEG_PER_H)
    site = accuracy_trials.SITE
    true_site = replace(site, gravity_m_s2=site.gravity_m_s2 + rng.standard_normal() * site.gravity_sigma_m_s2)
    out = []
    for _ in range(count):
        motion = on_fixture(rng, site=true_site, sample_rate_hz=100.0)
        out.append(read_out(motion.stated_as(site=site), truth, accuracy_trials.GRADES["navigation"], rng))
    return out, truth


@cache
def calibrations_of(seed, estimator="closed-form"):
    return tuple(srt.calibrate(r, estimator, checks=False) for r in recordings(seed)[0])


def sum_is_chi_square(total, freedom):
    assert chdtri(freedom, 1.0 - TAIL) < total < chdtri(freedom, TAIL), (total, freedom)


@pytest.mark.parametrize(
    ("estimator", "count"),
    [("closed-form", 3), *(pytest.param(e, 40, marks=pytest.mark.campaign) for e in ("closed-form", "least-squares"))],
)
def test_merged_units_are_consistent(estimator, count):
    """NEES of the merged values over units, and chi-squares of the recordings' agreement, are chi-square distributed.

    With a variance between recordings allowed for, where there is none, sigmas can only be larger.
    """
    nees, statistics, probabilities = 0.0, [], []
    for seed in range(count):
        truth = recordings(seed, 0)[1]
        calibrations = calibrations_of(seed, estimator)
        merged = merge_calibrations(calibrations, between=False)
        nees += accuracy_trials.score(merged, truth).nees * N_PARAMETERS
        table = merged.diagnostics.repeatability
        assert table.degrees_of_freedom == 2 * N_PARAMETERS
        statistics.append(table.chi_square)
        probabilities.append([row.probability for row in table.parameters])
        wider = merge_calibrations(calibrations)
        assert np.all(wider.sigma >= merged.sigma * (1.0 - 1e-9))
        # Weighted means of three, one of which may have noise of its own or an instability by chance.
        ratio = merged.sigma * np.sum([c.sigma**-2.0 for c in calibrations], axis=0) ** 0.5
        # Gravity alone keeps the sigmas of the scales from falling by √3.
        assert np.all(ratio[SCALE] > 0.65 * np.sqrt(3.0))
        assert np.all(np.abs(np.delete(ratio, np.arange(N_PARAMETERS)[SCALE]) - 1.0) < 0.05)
    sum_is_chi_square(nees, N_PARAMETERS * count)
    sum_is_chi_square(sum(statistics), 2 * N_PARAMETERS * count)
    if count >= 40:
        # Uniform by parameter; 27 of them are looked at.
        for name, values in zip(NAMES, np.array(probabilities).T, strict=True):
            assert kstest(values, "uniform").pvalue > TAIL / N_PARAMETERS, name


def test_estimators_may_be_mixed():
    """A filter's and a closed form's calibration, of two recordings: gravity is common to them all the same."""
    pytest.importorskip("filterpy")
    both = [srt.calibrate(r, e, checks=False) for r, e in zip(recordings(2, 2)[0], ("ekf", "closed-form"), strict=True)]
    gravity = [c.noise.gravity_effect for c in both]
    np.testing.assert_allclose(gravity[0][SCALE], gravity[1][SCALE], rtol=0.02)
    merged = merge_calibrations(both, between=False)
    np.testing.assert_allclose(merged.contributions["gravity"][SCALE], gravity[1][SCALE], rtol=0.02)


def test_held_in_all_stays_held():
    partial = [srt.calibrate(r, hold=("accel_scale",), checks=False) for r in recordings(1, 2)[0]]
    merged = merge_calibrations(partial)
    assert merged.status == "partial"
    assert set(merged.fixed) == set(NAMES[GROUP_SLICES["accel_scale"]])
    assert np.all(merged.covariance[~merged.observed] == 0.0)
    assert "Fixed, not observed" in merged.message


# Mounting, temperature, what is refused


def test_the_table_frame_is_kept_where_all_agree():
    calibrations = calibrations_of(1)
    merged = merge_calibrations(calibrations)
    # Means of turns of a milliradian: the chord's mean, to second order.
    np.testing.assert_allclose(merged.U, np.mean([c.U for c in calibrations], axis=0), atol=1e-5)
    np.testing.assert_allclose(merged.U @ merged.U.T, np.eye(3), atol=1e-14)
    assert merged.U_sigma_rad == calibrations[0].U_sigma_rad
    angle = 0.1
    turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    other = merge_calibrations([calibrations[0], replace(calibrations[1], U=turn)])
    assert other.U is None
    assert any("disagree on the mounting of the unit" in w for w in other.warnings)
    none = merge_calibrations([calibrations[0], replace(calibrations[1], U=None, U_sigma_rad=None)])
    assert none.U is None
    assert [row.U is None for row in none.diagnostics.repeatability.recordings] == [False, True]


def test_provenance_and_text():
    calibrations = [
        replace(
            c,
            temperature=Temperature(20.0 + n, 2.0),
            provenance=replace(c.provenance, date=f"2026-0{n + 1}-01", data_sha256=f"{n}" * 64),
        )
        for n, c in enumerate(calibrations_of(1))
    ]
    merged = merge_calibrations(calibrations, ["first", "second", "third"])
    assert merged.temperature == Temperature(21.0, 4.0)
    assert len(merged.provenance.recordings) == 3
    assert len(merged.provenance.data_sha256) == 64
    assert [row.sequence for row in merged.consistency.sequences] == ["first", "second", "third"]
    text = repeatability_text(merged)
    assert max(map(len, text.splitlines())) <= 80
    for word in ("first", "2026-02-01", "22.0", "scatter:", "p:", "farthest:", "All parameters together"):
        assert word in text
    assert repeatability_text(calibrations[0]) == ""


def test_many_recordings_fit_the_page():
    rng = np.random.default_rng(8)
    P = random_covariance(rng)
    calibrations = [made(1e-3 * rng.standard_normal(N_PARAMETERS), P) for _ in range(9)]
    text = repeatability_text(merge_calibrations(calibrations, [f"recording-{n}" for n in range(9)]))
    assert max(map(len, text.splitlines())) <= 80
    assert all(f"recording-{n}" in text for n in range(9))


def pair(**changes):
    P = np.eye(N_PARAMETERS) * 1e-12
    return [made(np.zeros(N_PARAMETERS), P), replace(made(np.zeros(N_PARAMETERS), P), **changes)]


@pytest.mark.parametrize(
    ("calibrations", "fragment"),
    [
        (pair()[:1], "two recordings"),
        (pair(provenance=Provenance(serial="SN-2")), "different units: 1 has the serial SN-1, 2 has SN-2"),
        (pair(estimator="merged"), "already merged"),
        (pair(provenance=Provenance(options={"prior": {"mean": {}}})), "with a prior"),
        (pair(covariance=np.zeros((N_PARAMETERS, N_PARAMETERS))), "sigma of gyro_scale_x is zero"),
        (pair(covariance=1.9 * np.eye(N_PARAMETERS) - 0.9), "not positive"),
    ],
)
def test_incompatible_calibrations_are_refused(calibrations, fragment):
    with pytest.raises(srt.InputError, match=fragment):
        merge_calibrations(calibrations)


def test_the_same_samples_do_not_count_twice():
    first, second = pair()
    twice = [replace(c, provenance=Provenance(data_sha256="a" * 64)) for c in (first, second)]
    with pytest.raises(srt.InputError, match="a and b hold the same samples"):
        merge_calibrations(twice, ["a", "b"])
    with pytest.raises(srt.InputError, match="needs its own name"):
        merge_calibrations([first, second], ["a", "a"])


def test_calibration_without_convergence_is_left_out():
    first, second = pair(status="not_converged")
    third = replace(first, errors=SensorErrors(np.full(N_PARAMETERS, 1e-7)))
    merged = merge_calibrations([first, second, third], ["a", "b", "c"], between=False)
    np.testing.assert_allclose(merged.errors.vector, 0.5e-7, rtol=1e-12)
    assert merged.diagnostics.repeatability.left_out == (OmittedRecording(name="b", status="not_converged"),)
    assert any(w.startswith("b is not converged") for w in merged.warnings)
    single = merge_calibrations([first, second], ["a", "b"])
    assert single.status == "converged"
    np.testing.assert_allclose(single.covariance, first.covariance)
    assert any("One recording alone" in w for w in single.warnings)
    assert "Repeatability" not in repeatability_text(single)
    with pytest.raises(srt.DataError, match="b is outside model"):
        merge_calibrations([second, replace(second, status="outside_model")], ["a", "b"])


def test_units_without_a_serial_are_taken_on_trust():
    first, second = pair(provenance=Provenance())
    merged = merge_calibrations([first, second], ["a", "b"])
    assert merged.provenance.serial == "SN-1"
    assert any("No serial is given with b" in w for w in merged.warnings)
