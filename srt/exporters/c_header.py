"""Header of C99 and C++ with the compensation of a calibration: the arithmetic of :mod:`srt.result.triad_inverse`."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from srt.exceptions import InputError
from srt.result.applier import Applier
from srt.result.triad_inverse import STEPS

if TYPE_CHECKING:
    from collections.abc import Iterable

    from srt.result.calibration import Calibration
    from srt.result.triad_inverse import TriadInverse

_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,30}")
_SUFFIXES: Final = {"double": "", "float": "f"}
"""Suffix of a literal by type."""
_UNSAFE: Final = re.compile(r"[^A-Za-z0-9 ./:,;()+@=_-]")

_COMMON: Final = """\
static inline void {name}_multiply_(const {real} m[9], const {real} x[3], {real} v[3])
{{
    int i;
    for (i = 0; i < 3; ++i)
        v[i] = m[3 * i] * x[0] + m[3 * i + 1] * x[1] + m[3 * i + 2] * x[2];
}}

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
/* {title}: increments y ({integral}) over dt (s) to true increments v ({integral}), MARS axes. v may be y. */
static inline void {name}_correct_{sensor}_increment(const {real} y[3], {real} dt, {real} v[3])
{{
    static const {real} bias[3] = {bias};
    static const {real} linear[9] = {linear};
{octants}\
    {real} x[3];
    x[0] = y[0] - bias[0] * dt;
    x[1] = y[1] - bias[1] * dt;
    x[2] = y[2] - bias[2] * dt;
    {solve}
}}

/* {title}: readings y ({unit}) to true values v ({unit}), MARS axes. v may be y. */
static inline void {name}_correct_{sensor}(const {real} y[3], {real} v[3])
{{
    {name}_correct_{sensor}_increment(y, {one}, v);
}}
"""

_TABLE: Final = """\
/* From MARS axes to those of the table-mounted frame: t = transpose(U) v. t may be v. */
static inline void {name}_mars_to_table(const {real} v[3], {real} t[3])
{{
    static const {real} m[9] = {rotation};
    {real} w[3];
    w[0] = v[0];
    w[1] = v[1];
    w[2] = v[2];
    {name}_multiply_(m, w, t);
}}
"""

_TABLE_SENSOR: Final = """\
/* As above, the result in axes of the table-mounted frame. */
static inline void {name}_correct_{sensor}_table(const {real} y[3], {real} t[3])
{{
    {name}_correct_{sensor}(y, t);
    {name}_mars_to_table(t, t);
}}

static inline void {name}_correct_{sensor}_increment_table(const {real} y[3], {real} dt, {real} t[3])
{{
    {name}_correct_{sensor}_increment(y, dt, t);
    {name}_mars_to_table(t, t);
}}
"""


def c99_header(calibration: Calibration, name: str = "imu", *, precision: Literal["double", "float"] = "double") -> str:
    """Text of a header of C99 and C++ with the compensation, without dependencies, the C library included.

    Parameters
    ----------
    calibration : Calibration
    name : str
        Prefix of all names, as in ``imu_correct_gyro``: a letter, then letters, digits and underscores.
    precision : "double" or "float"
        Type of all numbers. "float" computes in single precision alone, for processors without doubles.

    Returns
    -------
    str
        ASCII; the same for the same calibration. It defines, as static inline functions, ``NAME_correct_gyro(y, v)``
        and ``NAME_correct_accel(y, v)`` for rates, ``NAME_correct_gyro_increment(y, dt, v)`` and
        ``NAME_correct_accel_increment(y, dt, v)`` for increments, in MARS axes; with a table frame known, also the
        same ending in ``_table``, and ``NAME_mars_to_table(v, t)``.

    Raises
    ------
    InputError
        A name that C does not take, an unknown precision, or errors that cannot be undone.

    Notes
    -----
    Constants have 17 significant digits (9 for floats), which give back the same numbers. In double, with
    contraction of products and sums off (-ffp-contract=off), results are those of
    :class:`srt.result.applier.Applier` to the last bit on machines that compute in double. Readings that are not
    finite are not refused but come out as NaN or infinite.
    """
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise InputError(
            f"{name!r} cannot begin names in C: use a letter, then letters, digits or underscores, up to 31."
        )
    if precision not in _SUFFIXES:
        raise InputError(f"The precision is {precision!r}; it must be one of {', '.join(_SUFFIXES)}.")
    suffix = _SUFFIXES[precision]
    words = {"name": name, "real": precision, "zero": f"0.0{suffix}", "one": f"1.0{suffix}"}
    applier = Applier(calibration, frame="mars" if calibration.U is None else "table")
    guard = f"{name.upper()}_CALIBRATION_H"
    parts = [
        _comment(calibration, name, precision, table=applier.rotation is not None),
        f"#ifndef {guard}\n#define {guard}\n",
        _COMMON.format(**words, steps=STEPS),
        _sensor(applier.gyro, words, "gyro", "Gyros", "rad/s", "rad"),
        _sensor(applier.accel, words, "accel", "Accelerometers", "m/s^2", "m/s"),
    ]
    if applier.rotation is not None:
        parts.append(_TABLE.format(**words, rotation=_numbers(applier.rotation, precision)))
        parts += [_TABLE_SENSOR.format(**words, sensor=sensor) for sensor in ("gyro", "accel")]
    parts.append(f"#endif /* {guard} */\n")
    return "\n".join(parts)


def _sensor(inverse: TriadInverse, words: dict[str, str], sensor: str, title: str, unit: str, integral: str) -> str:
    name, precision = words["name"], words["real"]
    octants, solve = "", f"{name}_multiply_(linear, x, v);"
    if inverse.octants is not None:
        rows = ",\n        ".join(_numbers(row, precision, indent=9) for row in inverse.octants)
        octants = (
            "    /* By octant: bit i of the index is set where component i is negative. */\n"
            f"    static const {precision} octants[8][9] = {{\n        {rows}}};\n"
        )
        solve = f"{name}_solve_(linear, octants, x, v);"
    return _SENSOR.format(
        **words,
        sensor=sensor,
        title=title,
        unit=unit,
        integral=integral,
        bias=_numbers(inverse.bias, precision),
        linear=_numbers(inverse.linear, precision),
        octants=octants,
        solve=solve,
    )


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


def _comment(calibration: Calibration, name: str, precision: str, *, table: bool) -> str:
    """Heading comment; texts from files keep only characters that cannot end a comment."""

    def stated(key: str) -> str:
        value = calibration.provenance.get(key)
        return _UNSAFE.sub("_", str(value))[:200] if value else "not stated"

    frame = f"MARS, the frame in which the gyro matrix is symmetric{'; _table: table-mounted frame' if table else ''}"
    lines = [
        "Correction of IMU readings; generated, do not edit.",
        "",
        f"serial:    {stated('serial')}",
        f"date:      {stated('date')}",
        f"data hash: {stated('data_sha256')} (SHA-256 of the samples)",
        f"software:  {stated('software')}",
        f"status:    {_UNSAFE.sub('_', calibration.status)} ({_UNSAFE.sub('_', str(calibration.estimator))})",
        "",
        "units:     rad/s and m/s^2; increments rad and m/s with dt in s",
        f"frame:     {frame}",
        "formula:   readings are y = M v + s |v| + b, element by element where not a matrix;",
        "           v = inverse(M + diag(s sign(v))) (y - b), with the signs that v has itself.",
        "           Increments: b dt in place of b. Specific force at rest points up.",
        "",
        f"use:       {precision} v[3]; {name}_correct_gyro(y, v);",
        "           Asymmetry s rectifies the noise of a channel near zero: a mean of -0.8 s times the",
        "           one-sigma noise of a sample is left; average readings of stillness before correcting.",
        "           Readings that are not finite come out as such. Compile without -ffast-math.",
    ]
    return "\n".join(["/*", *(f" * {line}".rstrip() for line in lines), " */", ""])
