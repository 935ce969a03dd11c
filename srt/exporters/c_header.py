"""C99 header of a calibration, without dependencies: the arithmetic of :mod:`srt.result.triad_inverse`."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from srt.exceptions import InputError
from srt.result.applier import Applier
from srt.result.triad_inverse import STEPS

if TYPE_CHECKING:
    from collections.abc import Iterable

    from srt.result.calibration import Calibration
    from srt.result.triad_inverse import TriadInverse

_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,30}")
_UNSAFE: Final = re.compile(r"[^A-Za-z0-9 ./:,;()+@=_-]")

_COMMON: Final = """\
static inline void {name}_multiply_(const double m[9], const double x[3], double v[3])
{{
    int i;
    for (i = 0; i < 3; ++i)
        v[i] = m[3 * i] * x[0] + m[3 * i + 1] * x[1] + m[3 * i + 2] * x[2];
}}

static inline int {name}_octant_(const double v[3])
{{
    return (v[0] < 0.0 ? 1 : 0) + (v[1] < 0.0 ? 2 : 0) + (v[2] < 0.0 ? 4 : 0);
}}

/* Finds the octant that the solution itself lies in; x is a reading less its bias. */
static inline void {name}_solve_(const double linear[9], const double octants[8][9], const double x[3], double v[3])
{{
    int step, octant, found, i;
    double w[3], outside, contradiction, least = -1.0;
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
        contradiction = 0.0;
        for (i = 0; i < 3; ++i) {{
            outside = (octant >> i) & 1 ? w[i] : -w[i];
            if (outside > contradiction)
                contradiction = outside;
        }}
        if (least < 0.0 || contradiction < least) {{
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
static inline void {name}_correct_{sensor}_increment(const double y[3], double dt, double v[3])
{{
    static const double bias[3] = {bias};
    static const double linear[9] = {linear};
{octants}\
    double x[3];
    x[0] = y[0] - bias[0] * dt;
    x[1] = y[1] - bias[1] * dt;
    x[2] = y[2] - bias[2] * dt;
    {solve}
}}

/* {title}: readings y ({unit}) to true values v ({unit}), MARS axes. v may be y. */
static inline void {name}_correct_{sensor}(const double y[3], double v[3])
{{
    {name}_correct_{sensor}_increment(y, 1.0, v);
}}
"""

_TABLE: Final = """\
/* From MARS axes to those of the table-mounted frame: t = transpose(U) v. t may be v. */
static inline void {name}_mars_to_table(const double v[3], double t[3])
{{
    static const double m[9] = {rotation};
    double w[3];
    w[0] = v[0];
    w[1] = v[1];
    w[2] = v[2];
    {name}_multiply_(m, w, t);
}}
"""

_TABLE_SENSOR: Final = """\
/* As above, the result in axes of the table-mounted frame. */
static inline void {name}_correct_{sensor}_table(const double y[3], double t[3])
{{
    {name}_correct_{sensor}(y, t);
    {name}_mars_to_table(t, t);
}}

static inline void {name}_correct_{sensor}_increment_table(const double y[3], double dt, double t[3])
{{
    {name}_correct_{sensor}_increment(y, dt, t);
    {name}_mars_to_table(t, t);
}}
"""


def c99_header(calibration: Calibration, name: str = "imu") -> str:
    """Write a calibration as a header of C99 that needs nothing else, the C library included.

    Parameters
    ----------
    calibration : Calibration
    name : str
        Prefix of all names, as in ``imu_correct_gyro``: a letter, then letters, digits and underscores.

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
        A name that C does not take, or errors that cannot be undone.

    Notes
    -----
    Constants have 17 significant digits, which give back the same doubles. With contraction of products and sums off
    (-ffp-contract=off) results are those of :class:`srt.result.applier.Applier` to the last bit on machines that
    compute in double. Readings that are not finite are not refused but come out as NaN or infinite.
    """
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise InputError(
            f"{name!r} cannot begin names in C: use a letter, then letters, digits or underscores, up to 31."
        )
    applier = Applier(calibration, frame="mars" if calibration.U is None else "table")
    guard = f"{name.upper()}_CALIBRATION_H"
    parts = [
        _comment(calibration, name, table=applier.rotation is not None),
        f"#ifndef {guard}\n#define {guard}\n",
        _COMMON.format(name=name, steps=STEPS),
        _sensor(applier.gyro, name, "gyro", "Gyros", "rad/s", "rad"),
        _sensor(applier.accel, name, "accel", "Accelerometers", "m/s^2", "m/s"),
    ]
    if applier.rotation is not None:
        parts.append(_TABLE.format(name=name, rotation=_numbers(applier.rotation, 3)))
        parts += [_TABLE_SENSOR.format(name=name, sensor=sensor) for sensor in ("gyro", "accel")]
    parts.append(f"#endif /* {guard} */\n")
    return "\n".join(parts)


def _sensor(inverse: TriadInverse, name: str, sensor: str, title: str, unit: str, integral: str) -> str:
    octants, solve = "", f"{name}_multiply_(linear, x, v);"
    if inverse.octants is not None:
        rows = ",\n        ".join(_numbers(row, 3, indent=9) for row in inverse.octants)
        octants = (
            "    /* By octant: bit i of the index is set where component i is negative. */\n"
            f"    static const double octants[8][9] = {{\n        {rows}}};\n"
        )
        solve = f"{name}_solve_(linear, octants, x, v);"
    return _SENSOR.format(
        name=name,
        sensor=sensor,
        title=title,
        unit=unit,
        integral=integral,
        bias=_numbers(inverse.bias, 3),
        linear=_numbers(inverse.linear, 3),
        octants=octants,
        solve=solve,
    )


def _numbers(values: Iterable[float], per_line: int, indent: int = 8) -> str:
    texts = [_number(value) for value in values]
    lines = [", ".join(texts[i : i + per_line]) for i in range(0, len(texts), per_line)]
    return "{" + (",\n" + " " * indent).join(lines) + "}"


def _number(value: float) -> str:
    text = f"{value:.17g}"
    # Without a point or an exponent C reads an integer.
    return text if any(mark in text for mark in ".e") else f"{text}.0"


def _comment(calibration: Calibration, name: str, *, table: bool) -> str:
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
        f"use:       double v[3]; {name}_correct_gyro(y, v);",
        "           Asymmetry s rectifies the noise of a channel near zero: a mean of -0.8 s times the",
        "           one-sigma noise of a sample is left; average readings of stillness before correcting.",
        "           Readings that are not finite come out as such. Compile without -ffast-math.",
    ]
    return "\n".join(["/*", *(f" * {line}".rstrip() for line in lines), " */", ""])
