"""The closed-form inversion, eqs. 13-14: exact inverse of the signatures, and what it does with fewer sequences."""

import numpy as np
import pytest
from ideal_table_1 import SAMPLE_RATE_HZ, component_rows
from test_equations_signatures import G, ideal_jacobian

import sims
from srt.closed_form.formulas import SelectedFormulas
from srt.estimation.options import Options
from srt.estimation.registry import COMPLETING
from srt.estimation.srt_measurements import SrtProcessor
from srt.model import srt_formulas
from srt.model.table1 import SEQUENCES
from srt.recording.recording import Site
from srt.sensor_errors import GROUP_SLICES, INDEX, N_PARAMETERS, NAMES, SensorErrors
from srt.sequences.preparation import prepare

ALL = tuple(SEQUENCES)
ASYMMETRY = NAMES[GROUP_SLICES["gyro_asymmetry"]]
CLOSED_FORM = NAMES[:24]

# What each sequence alone is needed for. Of a reversed pair one may be missing: the other then gives the scale
# factor as without asymmetry.
LOST = {
    "1": {"gyro_asymmetry_y"},
    "1a": {"gyro_asymmetry_y"},
    "2": {"gyro_asymmetry_x"},
    "2a": {"gyro_asymmetry_x"},
    "3": {"gyro_asymmetry_z"},
    "3a": {"gyro_asymmetry_z"},
    "4": {
        "gyro_orthogonality_yz",
        "accel_bias_y",
        "accel_misalignment_yz",
        "accel_misalignment_zy",
        "accel_asymmetry_y",
    },
    "5": {
        "gyro_orthogonality_zx",
        "accel_bias_x",
        "accel_misalignment_xz",
        "accel_misalignment_zx",
        "accel_asymmetry_x",
    },
    "6": {"gyro_orthogonality_xy", "accel_misalignment_xy", "accel_misalignment_yx"},
    "7": {
        "accel_bias_z",
        "accel_misalignment_xy",
        "accel_scale_y",
        "accel_asymmetry_y",
        "accel_asymmetry_z",
    },
    "8": {"accel_misalignment_xz", "accel_scale_z", "accel_asymmetry_z"},
    "9": {"accel_misalignment_zx", "accel_scale_x", "accel_asymmetry_x"},
    "10": {"accel_misalignment_zy"},
    "11": {"accel_misalignment_yz"},
    "12": {"accel_misalignment_yx"},
    "13": {"accel_bias_y", "accel_asymmetry_y"},
    "14": {"accel_bias_x", "accel_asymmetry_x"},
}


def jacobian(chosen):
    """Ideal derivative of the components that formulas read, shape (number of components, 27)."""
    by_sequence = {name: ideal_jacobian(name) for name in SEQUENCES}
    H = np.array([by_sequence[c.sequence][c.kind] for c in srt_formulas.components(chosen)])
    H[:, GROUP_SLICES["gyro_bias"]] = 0.0
    return H


def dimensionless(M):
    """Rows and columns of accelerometer bias in g, so that one tolerance serves all."""
    unit = np.ones(N_PARAMETERS)
    unit[GROUP_SLICES["accel_bias"]] = G
    return M / unit[:, None] * unit


def test_inversion_is_exact_with_asymmetry():
    chosen = srt_formulas.formulas(ALL)
    product = dimensionless(srt_formulas.inversion_matrix(chosen, G) @ jacobian(chosen))
    expected = np.diag([1.0] * 24 + [0.0] * 3)
    np.testing.assert_allclose(product, expected, rtol=0, atol=1e-12)
    assert {f.parameter for f in chosen} == set(CLOSED_FORM)
    assert srt_formulas.missing_parameters(chosen) == ()


@pytest.mark.parametrize(
    "sequences",
    [ALL, [s for s in ALL if not s.endswith("a")], [s for s in ALL if s not in {"1", "2", "3"}]],
    ids=["17", "14", "14 with the reversed ones"],
)
def test_inversion_is_exact_without_asymmetry(sequences):
    """Eq. 14; with the reversed sequences at hand the pairs are averaged instead."""
    chosen = srt_formulas.formulas(sequences, asymmetry=False)
    product = dimensionless(srt_formulas.inversion_matrix(chosen, G) @ jacobian(chosen))
    kept = [i for i, n in enumerate(CLOSED_FORM) if n not in ASYMMETRY]
    np.testing.assert_allclose(product[np.ix_(kept, kept)], np.eye(len(kept)), rtol=0, atol=1e-12)
    assert srt_formulas.missing_parameters(chosen) == ASYMMETRY
    assert not product[GROUP_SLICES["gyro_asymmetry"]].any()


def test_an_asymmetry_adds_to_the_scale_factor_if_reversed_sequences_are_missing():
    """The price of eq. 14: κ_iii of a unit that has one comes out as κ_ii, and nowhere else."""
    chosen = srt_formulas.formulas([s for s in ALL if not s.endswith("a")])
    product = dimensionless(srt_formulas.inversion_matrix(chosen, G) @ jacobian(chosen))
    columns = product[:, GROUP_SLICES["gyro_asymmetry"]]
    np.testing.assert_allclose(columns[GROUP_SLICES["gyro_scale"]], np.eye(3), rtol=0, atol=1e-12)
    np.testing.assert_allclose(columns[3:], 0.0, atol=1e-12)


@pytest.mark.parametrize("missing", ALL)
def test_parameters_lost_with_one_sequence(missing):
    chosen = srt_formulas.formulas([s for s in ALL if s != missing])
    assert set(srt_formulas.missing_parameters(chosen)) == LOST[missing]


def test_parameters_lost_with_a_pair_of_scale_factor_sequences():
    def lost(*missing):
        return set(srt_formulas.missing_parameters(srt_formulas.formulas([s for s in ALL if s not in missing])))

    assert lost("1", "1a") == {"gyro_scale_y", "gyro_asymmetry_y"}
    assert lost("3", "3a") == {"gyro_scale_z", "gyro_asymmetry_z"}
    # Sequence 7 sees λz only beside κxx.
    assert lost("2", "2a") == {"gyro_scale_x", "gyro_asymmetry_x", "accel_bias_z", "accel_asymmetry_z"}


@pytest.mark.parametrize("missing", [*ALL, *([a, b] for a, b in (("1", "1a"), ("4", "9"), ("2", "14")))])
def test_remaining_formulas_are_exact(missing):
    """The remaining formulas invert their own parameters whichever sequences are missing; only asymmetry may leak."""
    chosen = srt_formulas.formulas([s for s in ALL if s not in missing and s != missing])
    product = dimensionless(srt_formulas.inversion_matrix(chosen, G) @ jacobian(chosen))
    found = [INDEX[f.parameter] for f in chosen]
    np.testing.assert_allclose(product[np.ix_(found, found)], np.eye(len(found)), rtol=0, atol=1e-12)
    others = [i for i, n in enumerate(CLOSED_FORM) if i not in found and n not in ASYMMETRY]
    np.testing.assert_allclose(product[np.ix_(found, others)], 0.0, atol=1e-12)


def test_no_sequences_no_formulas():
    assert srt_formulas.formulas([]) == ()
    assert srt_formulas.missing_parameters(()) == CLOSED_FORM
    assert srt_formulas.components(()) == ()
    # A bare sequence 14 needs υzx from elsewhere.
    assert srt_formulas.formulas(["14"]) == ()


def test_formulas_come_after_those_they_need_and_repeats_change_nothing():
    chosen = srt_formulas.formulas([*ALL, "7", "7", "1a"])
    assert chosen == srt_formulas.formulas(ALL)
    seen: set[str] = set()
    for formula in chosen:
        assert {p for _, p in formula.parameters} <= seen
        seen.add(formula.parameter)


@pytest.mark.parametrize(
    ("parameter", "sequences"),
    [
        ("gyro_scale_x", ("2", "2a")),
        ("gyro_orthogonality_xy", ("6",)),
        ("accel_bias_z", ("2", "2a", "7")),
        ("accel_bias_x", ("5", "14")),
        ("accel_misalignment_zx", ("5", "9")),
        ("accel_scale_z", ("8",)),
        ("accel_asymmetry_z", ("2", "2a", "7", "8")),
        ("accel_asymmetry_y", ("4", "7", "13")),
    ],
)
def test_sequences_needed(parameter, sequences):
    assert srt_formulas.sequences_needed(parameter) == sequences


def test_a_repeated_sequence_is_averaged():
    """Twice sequence 7 and thrice 8: their components enter with 1/2 and 1/3 each."""
    names = (*ALL, "7", "8", "8")
    motion = sims.table1_motion(
        site=Site(G), sequences=names, dwell_s=0.5, sample_rate_hz=SAMPLE_RATE_HZ, earth_rate=False
    )
    recording = sims.read_out(motion, SensorErrors())
    options = Options()
    data = prepare(recording, recording.sequences, options.average)
    solver = SelectedFormulas(data, options)
    once = srt_formulas.inversion_matrix(solver.formulas, data.gravity)
    order = {c: j for j, c in enumerate(solver.components)}
    rows = component_rows(data)  # of the last occurrence
    assert data.occurrences[-3:] == (2, 2, 3)
    for component, j in order.items():
        row = rows[component.sequence, component.kind]
        repeats = names.count(component.sequence)
        np.testing.assert_allclose(solver.coefficients[:24, row] * repeats, once[:24, j], rtol=1e-14)
    # The Jacobian step averages too: both give the same correction of a tiny error.
    truth = np.full(N_PARAMETERS, 1e-6)
    truth[GROUP_SLICES["gyro_bias"]] = 0.0  # the coefficients know of none
    recording = sims.read_out(motion, SensorErrors(truth))
    data = prepare(recording, recording.sequences, options.average)
    playback = SrtProcessor(data, options).process(SensorErrors())
    solver = SelectedFormulas(data, options)
    by_coefficients = (solver.coefficients @ playback.z)[solver.kept]
    S = solver.selection
    by_jacobian = np.linalg.solve(S @ playback.H[:, solver.kept], S @ playback.z)
    # The integrals of a recorded rotation take Ĉ of a 10 ms sample as the mean of its ends, (1 rad/s · 10 ms)²/12
    # = 8e-6 off, on each of some ten rotations' 2π·1e-6; products of two errors are 1e-12 times as much.
    np.testing.assert_allclose(by_jacobian, by_coefficients, rtol=0, atol=8e-6 * 10 * 2 * np.pi * 1e-6)


def test_sequences_that_alone_support_no_formula():
    """Of those, the automatic choice is least squares."""
    assert not srt_formulas.formulas(COMPLETING, asymmetry=False)
    assert all(srt_formulas.formulas({name}, asymmetry=False) for name in {*SEQUENCES} - COMPLETING)
