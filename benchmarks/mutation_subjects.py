"""Mutations of the source that ``mutations.py`` makes, and the tests that must notice them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Subject:
    """Mutations of one file.

    Attributes
    ----------
    name : str
    file : str
    tests : tuple of str
        Arguments of pytest.
    functions : tuple of str
        Functions whose signs are changed; a star stands for all.
    changes : tuple of (str, str)
        Text, which is there once, and the text in its place.
    without_effect : tuple of str
        Expressions of which a change of sign changes no result, with the reason beside them.
    """

    name: str
    file: str
    tests: tuple[str, ...]
    functions: tuple[str, ...] = ()
    changes: tuple[tuple[str, str], ...] = ()
    without_effect: tuple[str, ...] = ()


MODEL = (
    "tests/model/test_model_references.py",
    "tests/model/test_equations_signatures.py",
    "tests/model/test_jacobians.py::test_compensation_jacobians",
)
EXACT = "tests/estimation/test_accuracy.py::test_noise_free_on_a_perfect_fixture_is_exact"
SUBJECTS = (
    Subject(
        "eq. 1",
        "srt/estimation/srt_measurements.py",
        (
            "tests/estimation/test_srt_measurements.py",
            "tests/model/test_jacobians.py",
            "tests/estimation/test_g_sensitivity.py::test_noise_free_g_sensitivity_is_removed_entirely",
            EXACT,
        ),
        ("after_g_sensitivity", "process", "_without_g_sensitivity", "_down", "_carried_force"),
        (("g - np.linalg.norm(force, axis=-1)", "g - 1.000001 * np.linalg.norm(force, axis=-1)"),),
    ),
    Subject(
        "eq. 2",
        "srt/model/analytic_platform.py",
        (
            "tests/model/test_analytic_platform.py",
            "tests/model/test_platform_integrals.py",
            "tests/model/test_jacobians.py",
        ),
        ("integrate_attitude", "integrals", "_at_start"),
        (("-0.5 * earth_rate", "-1.0 * earth_rate"),),
    ),
    Subject(
        "eq. 2, samples",
        "srt/model/platform_steps.py",
        (
            "tests/model/test_analytic_platform.py",
            "tests/model/test_platform_integrals.py",
            "tests/model/test_jacobians.py",
        ),
        ("block", "extend", "_change", "_cross", "_times", "_compensate"),
        (("/ 12.0", "/ 13.0"),),
        ("a - 1", "b + 1", "a - lo", "b - a", "a - lo + b", "b - a + lo"),
    ),
    Subject(
        "eqs. 3-5",
        "srt/model/measurement_model.py",
        MODEL,
        ("*",),
        (
            ("residual[:, 2] += np.sin(non_orthogonality)", "residual[:, 2] += 0.0"),
            ("behind[:, 0, 2] = 1.0", "behind[:, 0, 2] = -1.0"),
            ("a_mean = 0.5 *", "a_mean = -0.5 *"),
            ("2.0 * np.pi) - np.pi", "-2.0 * np.pi) - np.pi"),
        ),
        ("angle + np.pi",),  # half a turn before the remainder by a whole one
    ),
    Subject(
        "eqs. 3, 20-21",
        "srt/model/rotation_integrals.py",
        MODEL,
        ("ideal_rotations", "_rodrigues_matrices", "_moments"),
        (
            ("window_s / 3.0", "window_s / 2.0"),
            ("half, cross, none = 0.5 *", "half, cross, none = -0.5 *"),
            ("0.5 * s**2, np", "-0.5 * s**2, np"),
            ("[none, 0.5 * angle + half, cross]", "[none, -0.5 * angle + half, cross]"),
            ("0.5 * angle - half", "-0.5 * angle - half"),
            ("ramp, ramp_s = 0.5 *", "ramp, ramp_s = -0.5 *"),
            ("((0.0, 1.0), (angle, -1.0))", "((0.0, -1.0), (angle, -1.0))"),
            ("share = 0.5 *", "share = -0.5 *"),
        ),
    ),
    Subject(
        "eqs. 6-11",
        "srt/model/sensor_model.py",
        ("tests/model/test_sensor_model.py",),
        ("inverses", "read", "compensate", "sensitivity", "_vectors", "vectors_in_mars", "compose"),
        (
            ("= basis[3 + k, j, i] = 0.5", "= basis[3 + k, j, i] = 0.4"),
            ("basis[3 + k, i, j] = basis[3 + k, j, i] = 0.5", "basis[3 + k, i, j] = 0.5; basis[3 + k, j, i] = -0.5"),
            ("basis[3 + k, i, j] = 1.0", "basis[3 + k, i, j] = -1.0"),
            ("accel.matrix @ np.swapaxes(U, -1, -2)", "accel.matrix @ U"),
        ),
    ),
    Subject(
        "eqs. 13-14",
        "srt/model/closed_form.py",
        ("tests/model/test_equations_closed_form.py",),
        ("_EQUATION_13_AFTER_GYRO_SCALE", "_GYRO_SCALE", "formulas"),
        (
            ("_4PI, _2PI = 4.0 * math.pi, 2.0 * math.pi", "_4PI, _2PI = 4.0 * math.pi, 4.0 * math.pi"),
            ('"y", 1.0)', '"y", -1.0)'),
            ('(1 / 2, sequence, "start")', '(-1 / 2, sequence, "start")'),
            *((f'(1 / 4, "{k}"', f'(-1 / 4, "{k}"') for k in (4, 5, 6)),
            *((f'(1 / 2, "{k}"', f'(-1 / 2, "{k}"') for k in range(7, 13)),
        ),
        ("found | given",),
    ),
    Subject("eqs. 15-19, 22", "srt/noise/accuracy_analysis.py", ("tests/noise/test_accuracy_analysis.py",), ("*",)),
    Subject("rotations", "srt/model/rotations.py", ("tests/model/test_rotations.py",), ("*",)),
    Subject(
        "noise sources",
        "srt/estimation/error_sources.py",
        (
            "tests/estimation/test_noise_sources.py",
            "tests/estimation/test_clock.py",
            "tests/joint/test_joint_jacobians.py",
        ),
        ("white_noise", "quantization", "raw_rate_variance"),
        (
            (
                "np.array([fixture.rotation_sigma_rad, fixture.rotation_sigma_rad, fixture.wobble])",
                "np.array([fixture.rotation_sigma_rad, fixture.rotation_sigma_rad, 0.0 * fixture.wobble])",
            ),
            (
                "0.0 if recording.fixture is None else recording.fixture.alignment_sigma_rad",
                "0.0 if recording.fixture is None else 0.5 * recording.fixture.alignment_sigma_rad",
            ),
            ("noise.accel_white[", "0.0 * noise.accel_white["),
            ("noise.accel_edge[", "0.0 * noise.accel_edge["),
            ("EARTH_RATE_RAD_S / math.sqrt(3.0)", "EARTH_RATE_RAD_S / math.sqrt(2.0)"),
            ('"rate": 2.0 * outer', '"rate": 1.0 * outer'),
            ("alone * outer", "0.0 * outer"),
        ),
        # Numbers only name the unknowns.
        ("np.cumsum(integrated) - 1", "number = np.where(integrated, np.cumsum(integrated) - 1, -1)"),
    ),
    Subject(
        "noise projected",
        "srt/closed_form/measurement_covariance.py",
        ("tests/estimation/test_noise_sources.py",),
        ("projection", "effect", "_earth_rate_error", "_attitude_errors"),
        (
            ("* sources.alignment_sigma(data.recording)", "* 0.0 * sources.alignment_sigma(data.recording)"),
            ("* sources.start_sigma(data.recording)", "* 0.0 * sources.start_sigma(data.recording)"),
            ("np.concatenate([to_body, leaning], axis=-1)", "np.concatenate([to_body, 0.0 * leaning], axis=-1)"),
            ("X @ X / 6.0", "X @ X / 5.0"),
        ),
    ),
    Subject(
        "rows of the joint system",
        "srt/joint/linearisation.py",
        (
            "tests/joint/test_joint_jacobians.py",
            "tests/estimators/test_drift_terms.py::test_columns_against_differences",
            "tests/estimators/test_drift_states.py",
        ),
        (
            "add_windows",
            "add_rotations",
            "add_fixture_attitudes",
            "_transition",
            "add_alignment",
            "add_bias_walk",
            "add_prior",
        ),
        (
            (
                "R[None] for source, R in alignment_covariances(joint, 3)",
                "R[None] / 4 for source, R in alignment_covariances(joint, 3)",
            ),
        ),
        (
            # The states of the accelerometers' drift are in no other row, and their distribution is symmetric.
            '*self.drift_blocks("accel", "force", -1.0),',
            "nobody = np.full(len(before), -1)",
        ),
    ),
    Subject(
        "moves",
        "srt/sequences/moves.py",
        ("tests/sequences/test_recognition.py",),
        ("_is_move",),
        (
            ("before.id is not None and after.id is not None", "(before.id is not None or after.id is not None)"),
            ("if before.pose or after.pose:", "if before.pose and after.pose:"),
            ("gaps_inside((first.start, last.stop))", "gaps_inside((first.start, first.stop))"),
            ("angles.sum(axis=0))) > MIN_TURN_RAD", "angles.sum(axis=0))) > 0.0 * MIN_TURN_RAD"),
        ),
    ),
    Subject(
        "angles between windows",
        "srt/sequences/manoeuvres.py",
        ("tests/sequences/test_recognition.py",),
        ("angles_between",),
        (('if recording.kind == "rate":', 'if recording.kind != "rate":'),),
    ),
    Subject(
        "moves that contradict",
        "srt/joint/recording_opening.py",
        ("tests/estimators/test_moves.py",),
        (),
        (
            ("off > _GROSS_RAD", "off > 1e3 * _GROSS_RAD"),
            ("not is_move[worst] or probability", "is_move[worst] and probability"),
            ("probability > CONTRADICTION_PROBABILITY", "probability > 0.0 * CONTRADICTION_PROBABILITY"),
            ("scale = max(1.0,", "scale = max(1e9,"),
        ),
    ),
    Subject(
        "verdict",
        "srt/result/verdict.py",
        ("tests/result/test_verdict.py",),
        (),
        (
            ("MISFIT_PROBABILITY: Final = 1e-3", "MISFIT_PROBABILITY: Final = 1e-2"),
            ("UNUSUAL: Final = 0.05", "UNUSUAL: Final = 0.1"),
            ("LARGEST_RATIO: Final = 3.0", "LARGEST_RATIO: Final = 30.0"),
            ("_MANY: Final = 30", "_MANY: Final = 300"),
            ("p > 1.0 - MISFIT_PROBABILITY", "p > 1.0 + MISFIT_PROBABILITY"),
            ("word = DOUBTFUL if added or found else PARTIAL", "word = DOUBTFUL if added else PARTIAL"),
            ('f.effect.startswith("exit")', 'f.effect.startswith("no")'),
            ("stdtrit(freedom, 0.975)", "stdtrit(freedom, 0.95)"),
            ("    if overridden:", "    if False:"),
        ),
    ),
    Subject(
        "sources of noise",
        "srt/estimation/error_sources.py",
        ("tests/estimation/test_noise_sources.py", "tests/estimation/test_unseen_errors.py"),
        (),
        (
            ("(by.rate, q[..., None, :] ** 2", "(by.rate, 0.81 * q[..., None, :] ** 2"),
            ("integrals.noise, q**2)", "integrals.noise, 0.81 * q**2)"),
            ("noise.accel_white[", "0.9 * noise.accel_white["),
            ("A = (by.angle", "A = (0.9 * by.angle"),
            ("per_rate, end = by.rate *", "per_rate, end = 0.9 * by.rate *"),
            ("noise.accel_edge[", "0.9 * noise.accel_edge["),
            ("(edges[data.start, 1], -A)", "(edges[data.start, 1], A)"),
            ("(edges[data.end, 0], end)", "(edges[data.end, 0], -end)"),
            (
                "[(edges[:, 0], -per_rate), (edges[:, 1], per_rate)]",
                "[(edges[:, 0], per_rate), (edges[:, 1], per_rate)]",
            ),
            ("np.array([fixture.rotation_sigma_rad,", "np.array([0.9 * fixture.rotation_sigma_rad,"),
            ("fixture.wobble])", "0.9 * fixture.wobble])"),
            ("error = -sigma *", "error = -0.9 * sigma *"),
        ),
    ),
    Subject(
        "accuracy of the fixture",
        "srt/closed_form/fixture_accuracy.py",
        ("tests/closed_form/test_units.py",),
        (),
        (
            ("parts = _squared(wobble), _squared(angles)", "parts = _squared(wobble), 0.25 * _squared(angles)"),
            ("or one_group_explains(*found)", "or False"),
            ("if not is_misfit(*found[1:])", "if False"),
        ),
    ),
    Subject(
        "one faulty group",
        "srt/estimation/goodness_of_fit.py",
        ("tests/estimation/test_goodness_of_fit.py",),
        (),
        (
            ("chi_square, degrees_of_freedom) - 2.0 *", "chi_square, degrees_of_freedom) + 2.0 *"),
            ("likelihood_gain(own, freedom,", "likelihood_gain(own, 1,"),
            ("not is_misfit(rest, others)) and", "True) and"),
            ("gain > against", "gain > -math.inf"),
            ("len(tests) if free and tests else 1", "1"),
        ),
    ),
    Subject(
        "residuals in units of their noise",
        "srt/estimation/white_residuals.py",
        ("tests/estimation/test_goodness_of_fit.py",),
        (),
        (
            ("<= _DEPENDENT", "<= -1.0"),
            ("left = own - Q @", "left = own + Q @"),
            ("values > LEAST_PREDICTED_SHARE", "values > -1.0"),
            ("white - self.basis @", "white + self.basis @"),
        ),
    ),
    Subject(
        "accuracy of the rotations",
        "srt/estimation/rotation_accuracy.py",
        ("tests/estimation/test_goodness_of_fit.py",),
        (),
        (
            ("    if n < _FEWEST:", "    if n < 2:"),
            ("2.0 * ndtr(-size[middle])", "ndtr(-size[middle])"),
            ("size <= _ALIKE *", "size <= 100.0 *"),
        ),
    ),
    Subject(
        "projected sources",
        "srt/closed_form/measurement_covariance.py",
        ("tests/estimation/test_noise_sources.py",),
        (),
        (
            ("* sources.alignment_sigma(data.recording)", "* 0.0 * sources.alignment_sigma(data.recording)"),
            (
                "common * sources.alignment_sigma(data.recording)",
                "common * 0.9 * sources.alignment_sigma(data.recording)",
            ),
            ("(data.recording.site.gravity_sigma_m_s2 * -up)", "(0.9 * data.recording.site.gravity_sigma_m_s2 * -up)"),
            ("slope * size[", "slope * 0.9 * size["),
            ("parts * floor[", "0.9 * parts * floor["),
            ("by.rate * floor[", "0.9 * by.rate * floor["),
        ),
    ),
    Subject(
        "fixed values",
        "srt/closed_form/iteration.py",
        ("tests/estimation/test_noise_sources.py",),
        (),
        (("held = measurements.H * np", "held = 0.9 * measurements.H * np"),),
    ),
    Subject(
        "fixed values of the joint model",
        "srt/joint/solution_analysis.py",
        ("tests/estimation/test_noise_sources.py", "tests/estimation/test_unseen_errors.py"),
        (),
        (
            (
                "root = solution.rows_with_parameters.T @ effect",
                "root = 0.9 * solution.rows_with_parameters.T @ effect",
            ),
            ("@ error\n", "@ error * 0.9\n"),
        ),
    ),
    Subject(
        "digest",
        "srt/result/json_file.py",
        ("tests/result/test_calibration.py", "tests/reports/test_certificate.py"),
        (),
        (
            ("document[_DIGEST] != _digest(document)", "False"),
            ("if changed and not trust", "if changed and trust"),
            ("if signed and _DIGEST not in document", "if _DIGEST not in document"),
            (
                "for key, value in document.items() if key != _DIGEST",
                'for key, value in document.items() if key not in (_DIGEST, "parameters")',
            ),
        ),
    ),
    Subject(
        "applied calibrations",
        "srt/result/triad_inverse.py",
        ("tests/result/test_apply.py",),
        ("*",),
        without_effect=(
            *("-1", "-2"),  # of an array with three axes
            # Octant 4 of 8 is octant -4 too.
            "(1 if p < 0.0 else 0) + (2 if q < 0.0 else 0) + (4 if r < 0.0 else 0)",
        ),
    ),
    Subject(
        "export: linear part",
        "srt/exporters/linear_model.py",
        ("tests/exporters",),
        ("*",),
        without_effect=("size - size.mean(axis=0)",),  # multiplied by deviations, which sum to zero
    ),
    Subject("export: matrices", "srt/exporters/matrix_formats.py", ("tests/exporters",), ("*",)),
    Subject("export: parameter files", "srt/exporters/parameter_files.py", ("tests/exporters",), ("*",)),
    Subject("export: preintegration", "srt/exporters/preintegration.py", ("tests/exporters",), ("*",)),
    Subject("export: C header", "srt/exporters/c_header.py", ("tests/exporters/test_c_header.py",), ("*",)),
)
