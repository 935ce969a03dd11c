"""The generated C header: compiled with all warnings as errors, and as exact as the arithmetic that it repeats."""

import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from g_sensitive import with_g_sensitivity

import srt
from srt.exporters import ExportSettings, export, save
from srt.exporters.c_header import c99_header
from srt.model.rotations import rotation_matrix
from srt.model.sensor_model import MIN_SINGULAR_VALUE, SIGNS, accel_triad, gyro_triad
from srt.result.applier import Applier
from srt.result.calibration import Calibration
from srt.result.provenance import Provenance
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, SensorErrors

COMPILER = shutil.which("gcc") or shutil.which("cc")
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler")

DT = 0.005
# Reads samples of six doubles from standard input and writes, for each, the results of every function.
DRIVER = """
#include <stdio.h>
#include "{name}.h"
int main(void)
{{
    double y[6], v[{width}];
    while (fread(y, sizeof(double), 6, stdin) == 6) {{
        {name}_correct_gyro(y, v);
        {name}_correct_accel(y + 3, v + 3);
        {name}_correct_gyro_increment(y, {dt}, v + 6);
        {name}_correct_accel_increment(y + 3, {dt}, v + 9);
        {table}
        fwrite(v, sizeof(double), {width}, stdout);
    }}
    return 0;
}}
"""
TABLE_CALLS = """
        {name}_correct_gyro_table(y, v + 12);
        {name}_correct_accel_table(y + 3, v + 15);
        {name}_correct_gyro_increment_table(y, {dt}, v + 18);
        {name}_correct_accel_increment_table(y + 3, {dt}, v + 21);
"""


def calibrated(vector, *, table=True, **provenance):
    return Calibration(
        "closed-form",
        "converged",
        "Converged.",
        SensorErrors(vector),
        np.zeros((N_PARAMETERS, N_PARAMETERS)),
        U=rotation_matrix(np.array([0.1, -0.2, 0.15])) if table else None,
        provenance=Provenance(**provenance),
    )


def slopes(triad):
    return triad.matrix + SIGNS[:, :, None] * np.diag(triad.asymmetry)


def legal(calibration):
    return all(
        np.linalg.svd(slopes(t), compute_uv=False).min() > MIN_SINGULAR_VALUE and np.linalg.det(slopes(t)).min() > 0.0
        for t in (gyro_triad(calibration.errors), accel_triad(calibration.errors))
    )


def drawn(rng, **options):
    """Random errors up to 50 %, taken back until the readings have one inverse."""
    calibration = calibrated(rng.uniform(-0.5, 0.5, N_PARAMETERS), **options)
    while not legal(calibration):
        calibration = replace(calibration, errors=SensorErrors(0.8 * calibration.errors.vector))
    return calibration


def compiled(calibration, folder, name="imu"):
    """Build the driver and give a function of readings, shape (n, 6)."""
    table = calibration.U is not None
    width = 24 if table else 12
    (folder / f"{name}.h").write_text(c99_header(calibration, name), encoding="ascii")
    calls = TABLE_CALLS.format(name=name, dt=DT) if table else ""
    (folder / "main.c").write_text(DRIVER.format(name=name, dt=DT, width=width, table=calls))
    command = [COMPILER, "-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-ffp-contract=off", "-O2"]
    built = subprocess.run(
        [*command, str(folder / "main.c"), "-o", str(folder / "main")], check=False, capture_output=True, text=True
    )
    assert built.returncode == 0, built.stderr

    def run(y):
        done = subprocess.run([str(folder / "main")], input=y.tobytes(), check=True, capture_output=True)
        return np.frombuffer(done.stdout).reshape(len(y), width)

    return run


def samples(rng, n=400):
    """Ordinary readings, some near zero in one, two or all components, and zeros of both signs."""
    y = rng.normal(size=(n, 6)) * [1, 1, 1, 10, 10, 10]
    near = rng.random((n, 6)) < 0.3
    y[near] *= 10.0 ** rng.uniform(-20.0, -3.0, near.sum())
    y[:8] = 0.0
    y[4:8] = -0.0
    return y


@needs_compiler
@pytest.mark.parametrize("seed", range(4))
def test_compiled_header_is_the_applier(tmp_path, seed):
    rng = np.random.default_rng(seed)
    calibration = drawn(rng)
    biases = np.tile(calibration.errors.vector[[24, 25, 26, 9, 10, 11]], (100, 1))
    # Readings at the bias itself are true values of zero, where the octant is nobody's.
    y = np.vstack([samples(rng), biases * (1.0 + 1e-16 * rng.integers(-3, 4, (100, 6)))])
    results = compiled(calibration, tmp_path)(y)
    column = 0
    for frame in ("mars", "table"):
        for dt in (None, DT):
            found = Applier(calibration, frame=frame).apply(y[:, :3], y[:, 3:], dt=dt)
            for triad, expected in zip((gyro_triad, accel_triad), found, strict=True):
                t = triad(calibration.errors)
                singular = np.linalg.svd(slopes(t), compute_uv=False)
                size = np.linalg.norm(expected, axis=1) + np.linalg.norm(t.bias) / singular.max()
                bound = 4.0 * np.finfo(float).eps * singular.max() / singular.min() * size
                value = results[:, column : column + 3]
                assert np.all(np.linalg.norm(value - expected, axis=1) <= bound)
                column += 3


@needs_compiler
def test_without_table_frame_and_without_asymmetry(tmp_path):
    vector = np.random.default_rng(5).uniform(-0.2, 0.2, N_PARAMETERS)
    vector[GROUP_SLICES["gyro_asymmetry"]] = 0.0
    calibration = calibrated(vector, table=False)
    y = samples(np.random.default_rng(6))
    results = compiled(calibration, tmp_path, "left_2")(y)
    expected = np.hstack(Applier(calibration).apply(y[:, :3], y[:, 3:]))
    np.testing.assert_allclose(results[:, :6], expected, rtol=0.0, atol=1e-14)
    assert "table" not in c99_header(calibration)


@needs_compiler
def test_two_units_in_one_program_in_place_and_not_a_number(tmp_path):
    rng = np.random.default_rng(7)
    for name in ("a", "b"):
        (tmp_path / f"{name}.h").write_text(c99_header(drawn(rng), name))
    (tmp_path / "main.c").write_text(
        '#include "a.h"\n#include "b.h"\n#include "a.h"\n'
        "int main(void)\n{\n    double y[3] = {1.0, -2.0, 3.0}, v[3], n[3] = {0.0, 1.0, 2.0};\n"
        "    a_correct_gyro_table(y, v);\n    a_correct_gyro_table(y, y);\n    b_correct_accel(y, v + 0);\n"
        "    n[0] /= n[0];\n    a_correct_gyro(n, n);\n"
        "    a_correct_gyro_table(n, v);\n    return n[0] == n[0] || n[1] == n[1];\n}\n"
    )
    files = [str(tmp_path / "main.c"), "-o", str(tmp_path / "m")]
    subprocess.run([COMPILER, "-std=c99", "-Wall", "-Werror", "-pedantic", *files], check=True)
    subprocess.run([str(tmp_path / "m")], check=True)


@needs_compiler
@pytest.mark.parametrize("serial", ["*/ int x; /*", "a\\\nb", "??/", "// é\n*/", "SN-7 (left)"])
def test_texts_of_the_file_cannot_end_the_comment(tmp_path, serial):
    calibration = calibrated(np.full(N_PARAMETERS, 0.01), serial=serial, date=serial, software=["*/"])
    compiled(calibration, tmp_path)
    assert ("SN-7 (left)" in c99_header(calibration)) == (serial == "SN-7 (left)")


@needs_compiler
def test_a_second_calibration_of_the_same_prefix_is_an_error_and_the_same_one_is_not(tmp_path):
    for name, seed in (("left", 1), ("right", 2)):
        (tmp_path / f"{name}.h").write_text(c99_header(drawn(np.random.default_rng(seed))), encoding="ascii")
    results = []
    for second in ("left", "right"):
        (tmp_path / "main.c").write_text(f'#include "left.h"\n#include "{second}.h"\n')
        results.append(
            subprocess.run(
                [COMPILER, "-fsyntax-only", tmp_path / "main.c"], capture_output=True, text=True, check=False
            )
        )
    assert results[0].returncode == 0
    assert results[1].returncode != 0
    assert "Another calibration with names in imu_ is included: export one of them with another --" in results[1].stderr


def test_says_what_it_is_and_is_the_same_every_time():
    calibration = calibrated(
        np.full(N_PARAMETERS, 0.01),
        serial="SN-7",
        date="2024-05-06",
        data_sha256="ab" * 32,
        software="strapdown-rotation-test 0.1.0",
    )
    text = c99_header(calibration)
    assert text == c99_header(calibration)
    assert text.isascii()
    stated = "SN-7", "2024-05-06", "ab" * 32, "0.1.0", "rad/s and m/s^2", "MARS", "y = M v + s |v| + b", "-0.8"
    for fragment in stated:
        assert fragment in text
    assert "#include" not in text
    assert max(map(len, text.splitlines())) <= 120
    # Every constant reads back as the very double.
    applier = Applier(calibration)
    assert all(f"{value:.17g}" in text for row in applier.gyro.octants for value in row)


@pytest.mark.parametrize("name", ["", "2nd", "a-b", "a b", "_x", "é", "a" * 40, None])
def test_names_that_c_does_not_take_are_refused(name):
    with pytest.raises(srt.InputError, match="cannot begin names"):
        c99_header(calibrated(np.zeros(N_PARAMETERS)), name)


@pytest.mark.parametrize("namespace", ["class", "std", "co_await", "xor"])
def test_words_of_cpp_are_no_namespaces(namespace):
    with pytest.raises(srt.InputError, match=f"'{namespace}' is a word of C"):
        c99_header(calibrated(np.zeros(N_PARAMETERS)), namespace=namespace)


STRICT = ["-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-pedantic", "-Werror", "-ffp-contract=off", "-O2"]
FORMS = [("g++", f"-std=c++{year}") for year in (11, 14, 17, 20)] + [
    (COMPILER, f"-std=c{year}") for year in (99, 11, 17)
]
CLANG = [("clang++", f"-std=c++{year}") for year in (11, 14, 17, 20)] + [
    ("clang", f"-std=c{year}") for year in (99, 11, 17)
]
SINGLE_DRIVER = """
#include "imu.h"
#include <stdio.h>
int main(void)
{{
    {real} y[6], v[6];
    while (fread(y, sizeof y, 1, stdin) == 1) {{
        imu_correct_gyro(y, v);
        imu_correct_accel_increment(y + 3, {one}, v + 3);
        fwrite(v, sizeof v, 1, stdout);
    }}
    return 0;
}}
"""


@pytest.mark.parametrize("precision", ["double", "float"])
@pytest.mark.parametrize(("compiler", "standard"), [*FORMS, *CLANG])
def test_both_precisions_compile_without_warnings(tmp_path, compiler, standard, precision):
    """The single-precision code has no double, and its result is within single-precision rounding."""
    if compiler is None or shutil.which(compiler) is None:
        pytest.skip("no such compiler here")
    rng = np.random.default_rng(41)
    calibration = calibrated(rng.uniform(-0.1, 0.1, N_PARAMETERS))
    text = c99_header(calibration, precision=precision)
    assert ("double" in text) == (precision == "double")
    (tmp_path / "imu.h").write_text(text, encoding="ascii")
    suffix = "f" if precision == "float" else ""
    source = tmp_path / ("main.cpp" if compiler.endswith("++") else "main.c")
    source.write_text(SINGLE_DRIVER.format(real=precision, one=f"1.0{suffix}"))
    command = [compiler, standard, *STRICT, str(source), "-o", str(tmp_path / "main")]
    built = subprocess.run(command, check=False, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    y = samples(rng).astype(precision if precision == "double" else np.float32)
    done = subprocess.run([str(tmp_path / "main")], input=y.tobytes(), check=True, capture_output=True)
    found = np.frombuffer(done.stdout, dtype=y.dtype).reshape(len(y), 6)
    w, f = calibration.apply(y[:, :3].astype(float), y[:, 3:].astype(float))
    # Singular values of at least 0.6, so |M⁻¹| below 1.7. Bias, matrix, products and sums round once each, six
    # roundings in all on values up to (|y| + 0.1) 1.7 √3; close to a border of octants both signs are right to
    # the same order.
    eps = 0.5 * float(np.finfo(y.dtype).eps)
    for ours, theirs, part in ((w, found[:, :3], y[:, :3]), (f, found[:, 3:], y[:, 3:])):
        bound = (
            6.0 * eps * 1.7 * np.sqrt(3.0) * (np.linalg.norm(part, axis=1, keepdims=True) + 0.1 * np.sqrt(3.0)) * 1.7
        )
        assert np.all(np.abs(theirs - ours) <= bound)


FOLLOWED = """
#include "unit.h"
#include <stdio.h>
int main(void)
{{
    {real} y[6], v[12];
    while (fread(y, sizeof y, 1, stdin) == 1) {{
        {space}unit_correct(y, y + 3, v, v + 3);
        {space}unit_correct_table(y, y + 3, v + 6, v + 9);
        fwrite(v, sizeof v, 1, stdout);
    }}
    return 0;
}}
"""


@needs_compiler
@pytest.mark.parametrize("compiler", [COMPILER, "g++"])
@pytest.mark.parametrize("precision", ["double", "float"])
def test_g_sensitivity_and_namespace(tmp_path, compiler, precision):
    """The exported file: gyros that follow specific force, in a namespace, rates alone."""
    if shutil.which(compiler) is None:
        pytest.skip("no such compiler here")
    rng = np.random.default_rng(42)
    gamma = rng.uniform(-1e-3, 1e-3, (3, 3))
    calibration = replace(calibrated(rng.uniform(-0.1, 0.1, N_PARAMETERS)), diagnostics=with_g_sensitivity(gamma))
    settings = ExportSettings(prefix="unit", precision=precision, samples="rate", namespace="lab")
    made = export(calibration, "c-header", settings=settings)
    save(made, tmp_path / "unit.h")
    assert "_increment" not in made.texts[""]
    cpp = compiler == "g++"
    source = tmp_path / ("main.cpp" if cpp else "main.c")
    source.write_text(FOLLOWED.format(real=precision, space="lab::" if cpp else ""))
    command = [compiler, "-std=c++20" if cpp else "-std=c99", *STRICT, str(source), "-o", str(tmp_path / "main")]
    built = subprocess.run(command, check=False, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    y = samples(rng).astype(np.float64 if precision == "double" else np.float32)
    done = subprocess.run([str(tmp_path / "main")], input=y.tobytes(), check=True, capture_output=True)
    found = np.frombuffer(done.stdout, dtype=y.dtype).reshape(len(y), 12)
    wide = y.astype(np.float64)
    expected = np.hstack(
        [v for frame in ("mars", "table") for v in Applier(calibration, frame=frame).apply(wide[:, :3], wide[:, 3:])]
    )
    if precision == "double":
        # To the last bit, as the operations are the same in the same order.
        np.testing.assert_array_equal(found, expected)
    # As above, with the products and sums of Γ f and of the rotation: twelve roundings of up to 1.7² √3 (|y| + 0.2).
    eps = 0.5 * float(np.finfo(y.dtype).eps)
    size = np.linalg.norm(wide, axis=1, keepdims=True) + 0.2
    assert np.all(np.abs(found - expected) <= 12.0 * eps * 1.7**2 * np.sqrt(3.0) * size)


def test_an_edited_header_is_refused(tmp_path):
    made = export(calibrated(np.full(N_PARAMETERS, 0.01)), "c-header")
    with pytest.raises(srt.InputError, match="linear is not whole"):
        made.format.read({"": made.texts[""].replace("linear[9] = {", "linear[9] = {1.0, ")})
    with pytest.raises(srt.InputError, match="no place for topic"):
        export(calibrated(np.zeros(N_PARAMETERS)), "c-header", settings=ExportSettings(topic="/imu"))


def test_an_unknown_precision_is_refused():
    with pytest.raises(srt.InputError, match="one of double, float"):
        c99_header(calibrated(np.zeros(N_PARAMETERS)), precision="half")
