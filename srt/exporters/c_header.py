"""Header of C99 and C++ with the compensation of a calibration: the arithmetic of :mod:`srt.result.triad_inverse`."""

from __future__ import annotations

import hashlib
import re
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.exceptions import InputError
from srt.exporters.export_model import origin
from srt.exporters.file_format import SINGLE, Exporter
from srt.model.sensor_model import Triad
from srt.recording.file_marks import signed
from srt.result.applier import Applier
from srt.result.triad_inverse import STEPS

if TYPE_CHECKING:
    from collections.abc import Iterable

    from srt.exporters.export_model import ExportModel
    from srt.exporters.file_format import Fields, Texts
    from srt.result.calibration import Calibration
    from srt.result.triad_inverse import TriadInverse
    from srt.types import Array

_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,30}")
_RESERVED: Final = re.compile(
    r"alignas|alignof|and|and_eq|asm|auto|bitand|bitor|bool|break|case|catch|char|char16_t|char32_t|char8_t|"
    r"class|co_await|co_return|co_yield|compl|concept|const|const_cast|consteval|constexpr|constinit|continue|"
    r"decltype|default|delete|do|double|dynamic_cast|else|enum|explicit|export|extern|false|float|for|friend|"
    r"goto|if|inline|int|long|mutable|namespace|new|noexcept|not|not_eq|nullptr|operator|or|or_eq|private|"
    r"protected|public|register|reinterpret_cast|requires|return|short|signed|sizeof|static|static_assert|"
    r"static_cast|std|struct|switch|template|this|thread_local|throw|true|try|typedef|typeid|typename|union|"
    r"unsigned|using|virtual|void|volatile|wchar_t|while|xor|xor_eq"
)
"""Keywords of C++20, and the namespace of its library, which cannot name a namespace."""
_SUFFIXES: Final = {"double": "", "float": "f"}
"""Suffix of a literal by type."""
_KINDS: Final = {"both": ("", "_increment"), "rate": ("",), "increment": ("_increment",)}
"""Endings of the names of functions by the samples that are corrected: "" for rates, "_increment" for increments."""

_MULTIPLY: Final = """\
static inline void {name}_multiply_(const {real} m[9], const {real} x[3], {real} v[3])
{{
    int i;
    for (i = 0; i < 3; ++i)
        v[i] = m[3 * i] * x[0] + m[3 * i + 1] * x[1] + m[3 * i + 2] * x[2];
}}
"""

_SOLVE: Final = """\
static inline int {name}_octant_(const {real} v[3])
{{
    return (v[0] < {zero} ? 1 : 0) + (v[1] < {zero} ? 2 : 0) + (v[2] < {zero} ? 4 : 0);
}}

/* Finds the octant that the solution itself lies in; x is a reading less its bias. */
static inline void {name}_solve_(const {real} linear[9], const {real} octants[8][9], const {real} x[3], {real} v[3])
{{
    int step, octant, found, i;
    {real} w[3], outside, contradiction, least = -{one};
    {name}_multiply_(linear, x, v);
    found = {name}_octant_(v);
    for (step = 0; step < {steps}; ++step) {{
        octant = found;
        {name}_multiply_(octants[octant], x, v);
        found = {name}_octant_(v);
        if (found == octant)
            return;
    }}
    /* On a border of octants rounding may make the search alternate: the one that contradicts itself the least. */
    for (octant = 0; octant < 8; ++octant) {{
        {name}_multiply_(octants[octant], x, w);
        contradiction = {zero};
        for (i = 0; i < 3; ++i) {{
            outside = (octant >> i) & 1 ? w[i] : -w[i];
            if (outside > contradiction)
                contradiction = outside;
        }}
        if (least < {zero} || contradiction < least) {{
            least = contradiction;
            v[0] = w[0];
            v[1] = w[1];
            v[2] = w[2];
        }}
    }}
}}
"""

_SENSOR: Final = """\
/* {title}: {samples} y ({unit}){over} to true values v ({unit}), MARS axes. v may be y{but}. */
static inline void {name}_correct_{sensor}{kind}(const {real} y[3]{given}, {real} v[3])
{{
    {const} {real} bias[3] = {bias};
    {const} {real} linear[9] = {linear};
{octants}{sensitivity}\
    {real} x[3];
    x[0] = y[0] - bias[0]{times};
    x[1] = y[1] - bias[1]{times};
    x[2] = y[2] - bias[2]{times};
{follow}\
    {solve}
}}
"""

_FOLLOW: Final = """\
    {name}_multiply_(g_sensitivity, f, w);
    x[0] -= w[0];
    x[1] -= w[1];
    x[2] -= w[2];
"""

_PAIR: Final = """\
/* Both triads: {samples} gyro and accel to true rate and force, MARS axes; rate may be gyro, force may be accel. */
static inline void {name}_correct{kind}(const {real} gyro[3], const {real} accel[3]{step},
    {real} rate[3], {real} force[3])
{{
    {name}_correct_accel{kind}(accel{dt}, force);
    {name}_correct_gyro{kind}(gyro{force}{dt}, rate);
}}
"""

_TABLE: Final = """\
/* From MARS axes to those of the table-mounted frame: t = transpose(U) v. t may be v. */
static inline void {name}_mars_to_table(const {real} v[3], {real} t[3])
{{
    {const} {real} m[9] = {rotation};
    {real} w[3];
    w[0] = v[0];
    w[1] = v[1];
    w[2] = v[2];
    {name}_multiply_(m, w, t);
}}
"""

_TABLE_SENSOR: Final = """\
/* {name}_correct_{sensor}{kind} with the result in axes of the table-mounted frame. */
static inline void {name}_correct_{sensor}{kind}_table(const {real} y[3]{given}, {real} t[3])
{{
    {name}_correct_{sensor}{kind}(y{passed}, t);
    {name}_mars_to_table(t, t);
}}
"""

_TABLE_PAIR: Final = """\
/* {name}_correct{kind} with the results in axes of the table-mounted frame. */
static inline void {name}_correct{kind}_table(const {real} gyro[3], const {real} accel[3]{step},
    {real} rate[3], {real} force[3])
{{
    {name}_correct{kind}(gyro, accel{dt}, rate, force);
    {name}_mars_to_table(rate, rate);
    {name}_mars_to_table(force, force);
}}
"""

_HEAD: Final = """\
#ifndef {guard}
#define {guard}
#define {guard}_{digest}

/* Tables are constants of compilation in C++, and of the program in C. */
#if defined(__cplusplus) && __cplusplus >= 201103L
#define {guard}_TABLE_ static constexpr
#else
#define {guard}_TABLE_ static const
#endif
"""

_END: Final = """\
#undef {guard}_TABLE_

#elif !defined({guard}_{digest})
#error "Another calibration with names in {name}_ is included: export one of them with another --prefix."
#endif /* {guard} */
"""


def c99_header(
    calibration: Calibration,
    name: str = "imu",
    *,
    precision: str = "double",
    samples: str = "both",
    namespace: str | None = None,
) -> str:
    """Text of a header of C99 and C++ with the compensation, without dependencies, the C library included.

    Parameters
    ----------
    name : str
        Prefix of all names, as in ``imu_correct_gyro``: a letter, then letters, digits and underscores.
    precision : "double" or "float"
        Type of all numbers. "float" computes in single precision alone, for processors without doubles.
    samples : "both", "rate" or "increment"
        Samples that it corrects.
    namespace : str or None
        Namespace of C++ around the functions; C does not see it.

    Returns
    -------
    str
        ASCII; the same for the same calibration. It defines, as static inline functions in MARS axes,
        ``NAME_correct_gyro(y, v)``, ``NAME_correct_accel(y, v)`` and for both ``NAME_correct(gyro, accel, rate,
        force)``; for increments ``NAME_correct_gyro_increment(y, dt, v)`` and so on. With a table frame known, also the
        same ending in ``_table``, and ``NAME_mars_to_table(v, t)``. Gyros with g-sensitivity need the true specific
        force f as well: ``NAME_correct_gyro(y, f, v)``, which ``NAME_correct`` passes on.

    Raises
    ------
    InputError
        A name that C does not take, an unknown choice, or errors that cannot be undone.

    Notes
    -----
    Constants have 17 significant digits (9 for floats), which give back the same numbers. In double, with
    contraction of products and sums off (-ffp-contract=off), results are those of
    :class:`srt.result.applier.Applier` to the last bit on machines that compute in double. Readings that are not
    finite are not refused but come out as NaN or infinite.
    """
    for given in (name, *(() if namespace is None else (namespace,))):
        if not isinstance(given, str) or not _NAME.fullmatch(given):
            raise InputError(
                f"{given!r} cannot begin names in C: use a letter, then letters, digits or underscores, up to 31."
            )
    if namespace is not None and _RESERVED.fullmatch(namespace):
        raise InputError(f"{namespace!r} is a word of C++ and names no namespace: use another, as imu_{namespace}.")
    for what, choice, choices in (("precision", precision, _SUFFIXES), ("samples", samples, _KINDS)):
        if choice not in choices:
            raise InputError(f"The {what} is {choice!r}; it must be one of {', '.join(choices)}.")
    kinds = _KINDS[samples]
    applier = Applier(calibration, frame="mars" if calibration.U is None else "table")
    suffix, guard = _SUFFIXES[precision], f"{name.upper()}_CALIBRATION_H"
    words = {"name": name, "real": precision, "zero": f"0.0{suffix}", "one": f"1.0{suffix}", "const": f"{guard}_TABLE_"}
    parts = [_comment(calibration, words, kinds[0], applier), _HEAD]
    if namespace is not None:
        parts.append(f"#ifdef __cplusplus\nnamespace {namespace} {{\n#endif\n")
    parts.append(_MULTIPLY.format(**words))
    if applier.gyro.octants is not None or applier.accel.octants is not None:
        parts.append(_SOLVE.format(**words, steps=STEPS))
    parts += [_functions(applier, words, kind) for kind in kinds]
    if applier.rotation is not None:
        parts.append(_TABLE.format(**words, rotation=_numbers(applier.rotation, precision)))
        parts += [_table_functions(applier, words, kind) for kind in kinds]
    if namespace is not None:
        parts.append("#ifdef __cplusplus\n}\n#endif\n")
    digest = hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16].upper()
    parts[1] = _HEAD.format(guard=guard, digest=digest)
    parts.append(_END.format(guard=guard, digest=digest, name=name))
    return signed("\n".join(parts))


def _of_kind(words: dict[str, str], kind: str) -> dict[str, str]:
    """Words that differ between rates and increments."""
    increment = kind == "_increment"
    return {
        **words,
        "kind": kind,
        "samples": "increments" if increment else "readings",
        "step": f", {words['real']} dt" if increment else "",
        "dt": ", dt" if increment else "",
        "times": " * dt" if increment else "",
        "over": " over dt (s)" if increment else "",
    }


def _functions(applier: Applier, words: dict[str, str], kind: str) -> str:
    """Functions of both triads for one kind of samples."""
    words = _of_kind(words, kind)
    units = ("rad", "m/s") if kind else ("rad/s", "m/s^2")
    sensors = (
        ("accel", "Accelerometers", applier.accel, units[1], None),
        ("gyro", "Gyros", applier.gyro, units[0], applier.sensitivity),
    )
    texts = [_sensor(words, *sensor) for sensor in sensors]
    followed = applier.sensitivity is not None
    return "\n".join([*texts, _PAIR.format(**words, force=", force" if followed else "")])


def _sensor(
    words: dict[str, str],
    sensor: str,
    title: str,
    inverse: TriadInverse,
    unit: str,
    sensitivity: tuple[float, ...] | None,
) -> str:
    name, precision = words["name"], words["real"]
    octants, solve = "", f"{name}_multiply_(linear, x, v);"
    if inverse.octants is not None:
        rows = ",\n        ".join(_numbers(row, precision, indent=9) for row in inverse.octants)
        octants = (
            "    /* By octant: bit i of the index is set where component i is negative. */\n"
            f"    {words['const']} {precision} octants[8][9] = {{\n        {rows}}};\n"
        )
        solve = f"{name}_solve_(linear, octants, x, v);"
    matrix, follow, given = "", "", words["step"]
    if sensitivity is not None:
        matrix = (
            f"    {words['const']} {precision} g_sensitivity[9] = {_numbers(sensitivity, precision)};\n"
            f"    {precision} w[3];\n"
        )
        follow = _FOLLOW.format(**words)
        given = f", const {precision} f[3]{given}"
    return _SENSOR.format(
        **words,
        sensor=sensor,
        title=title,
        unit=unit,
        given=given,
        but="" if sensitivity is None else "; f is the true specific force",
        bias=_numbers(inverse.bias, precision),
        linear=_numbers(inverse.linear, precision),
        octants=octants,
        sensitivity=matrix,
        follow=follow,
        solve=solve,
    )


def _table_functions(applier: Applier, words: dict[str, str], kind: str) -> str:
    words = _of_kind(words, kind)
    texts = []
    for sensor in ("gyro", "accel"):
        followed = sensor == "gyro" and applier.sensitivity is not None
        given = (f", const {words['real']} f[3]" if followed else "") + words["step"]
        passed = (", f" if followed else "") + words["dt"]
        texts.append(_TABLE_SENSOR.format(**words, sensor=sensor, given=given, passed=passed))
    return "\n".join([*texts, _TABLE_PAIR.format(**words)])


def _numbers(values: Iterable[float], precision: str, indent: int = 8) -> str:
    """Initialiser of an array, three numbers a line."""
    texts = [_number(value, precision) for value in values]
    lines = [", ".join(texts[i : i + 3]) for i in range(0, len(texts), 3)]
    return "{" + (",\n" + " " * indent).join(lines) + "}"


def _number(value: float, precision: str) -> str:
    # 17 digits give the same double back, 9 the same float.
    text = f"{value:.17g}" if precision == "double" else f"{np.float32(value):.9g}"
    # Without a point or an exponent C reads an integer.
    return (text if any(mark in text for mark in ".e") else f"{text}.0") + _SUFFIXES[precision]


def _comment(calibration: Calibration, words: dict[str, str], kind: str, applier: Applier) -> str:
    """Heading comment."""
    name, precision = words["name"], words["real"]
    table = "; _table: table-mounted frame" if applier.rotation is not None else ""
    frame = f"MARS, the frame in which the gyro matrix is symmetric{table}"
    followed = applier.sensitivity is not None
    lines = [
        "Correction of IMU readings; generated, do not edit.",
        "",
        *origin(calibration),
        "",
        "units:     rad/s and m/s^2; increments rad and m/s with dt in s",
        f"frame:     {frame}",
        "formula:   readings are y = M v + s |v| + b, element by element where not a matrix;",
        "           v = inverse(M + diag(s sign(v))) (y - b), with the signs that v has itself.",
        *(
            ["           Gyros: y - G f in place of y, f the true specific force, G the g-sensitivity."]
            if followed
            else []
        ),
        "           Increments: b dt in place of b. Specific force at rest points up.",
        "",
        f"use:       {precision} rate[3], force[3];",
        f"           {name}_correct{kind}(gyro, accel{', dt' * bool(kind)}, rate, force);",
        "           Asymmetry s rectifies the noise of a channel near zero: a mean of -0.8 s times the",
        "           one-sigma noise of a sample is left; average readings of stillness before correcting.",
        "           Readings that are not finite come out as such. Compile without -ffast-math.",
    ]
    return "\n".join(["/*", *(f" * {line}".rstrip() for line in lines), " */", ""])


_ARRAY: Final = re.compile(r"(\w+)\[\d+\](?:\[9\])? = \{+([^;]*?)\}+;")
_FUNCTION: Final = re.compile(r"_correct_(gyro|accel)(?:_increment)?\(const")


def _write(model: ExportModel) -> dict[str, str]:
    settings = model.settings
    chosen = {"name": settings.prefix, "precision": settings.precision, "samples": settings.samples}
    stated = {name: value for name, value in chosen.items() if value is not None}
    return {"": c99_header(model.calibration, namespace=settings.namespace, **stated)}


def _read(texts: Texts) -> Fields:
    """Arrays of the functions of the first kind of samples, those of double and single precision alike."""
    if re.search(r"^#endif /\* \w+_CALIBRATION_H \*/\n\Z", texts[""], re.MULTILINE) is None:
        raise InputError("its last line is not the end of a header: it was truncated.")
    fields: dict[str, Array] = {}
    places = [(match.start(), match[1]) for match in _FUNCTION.finditer(texts[""])]
    for match in _ARRAY.finditer(texts[""]):
        sensor = next((name for start, name in reversed(places) if start < match.start()), None)
        name = "rotation" if match[1] == "m" else f"{sensor}_{match[1]}"
        numbers = re.sub(r"[{}f\s]", "", match[2]).split(",")
        try:
            fields.setdefault(name, np.array(numbers, dtype=np.float64))
        except ValueError:
            raise InputError(f"the table {match[1]} holds what is no number: it was edited.") from None
    for name, size in (("gyro_bias", 3), ("gyro_linear", 9), ("accel_bias", 3), ("accel_linear", 9)):
        if name not in fields or fields[name].size != size:
            raise InputError(f"its table {name} is not whole: it was truncated or edited.")
    return fields


def _apply(fields: Fields, gyro: Array, accel: Array) -> tuple[Array, Array]:
    """The functions' arithmetic for rates, by arrays."""
    triads = []
    for sensor in ("gyro", "accel"):
        matrix: Array = np.asarray(np.linalg.inv(fields[f"{sensor}_linear"].reshape(3, 3)), dtype=np.float64)
        asymmetry = np.zeros(3)
        if f"{sensor}_octants" in fields:
            asymmetry = np.diag(np.linalg.inv(fields[f"{sensor}_octants"][:9].reshape(3, 3)) - matrix).copy()
        triads.append(Triad(matrix, asymmetry, fields[f"{sensor}_bias"]))
    force = triads[1].compensate(accel)
    if "gyro_g_sensitivity" in fields:
        gyro = gyro - force @ fields["gyro_g_sensitivity"].reshape(3, 3).T
    return triads[0].compensate(gyro), force


C_HEADER: Final = Exporter(
    name="c-header",
    title="Header of C99 and C++",
    suffixes=(".h", ".hpp"),
    formula="solve y = matrix v + asymmetry |v| + bias for v (gyros: y - g_sensitivity a)",
    advice=(
        "--precision float for processors without doubles; --samples increment or rate leaves the other functions out; "
        "--namespace NAME puts them into a namespace of C++.",
        "Functions that end in _table give the axes of the mount. Compile without -ffast-math.",
    ),
    frames=("mars",),
    write=_write,
    read=_read,
    apply=_apply,
    within=SINGLE,
    asymmetry=True,
    g_sensitivity=True,
    options=frozenset({"prefix", "precision", "samples", "namespace"}),
)
