"""Several recordings of one unit merged into one calibration, by the model of :mod:`srt.comparison.merge_model`."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Final, TypeVar

import numpy as np
from scipy.special import chdtrc

from srt.arguments import require_type
from srt.comparison.merge_model import (
    GROUP_OF,
    StackedEstimates,
    between_sigma,
    estimate,
    repeatability,
    stack_estimates,
)
from srt.estimation.calibration_builder import partial_or_converged
from srt.estimation.leave_one_out import SequenceDiagnostics, consistency, consistency_tests, leave_one_out_estimates
from srt.exceptions import DataError, InputError
from srt.model.rotations import rotation_vector
from srt.result.calibration import Calibration, software
from srt.result.diagnostics import Diagnostics
from srt.result.noise_figures import NoiseFigures
from srt.result.provenance import Alignment, Provenance, StatedSite, Temperature
from srt.result.verdict import DOUBTFUL, USABLE
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, NAMES, SensorErrors

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from srt.types import Array, Indices


_Stated = TypeVar("_Stated", StatedSite, Alignment)

ESTIMATOR: Final = "merged"
UNLIKELY: Final = 1e-3
"""p-value below which recordings disagree: one false alarm in 1000 merged calibrations."""


def merge_calibrations(
    calibrations: Sequence[Calibration], names: Sequence[str] | None = None, *, between: bool = True
) -> Calibration:
    """Merge the calibrations of several recordings of one unit.

    Parameters
    ----------
    calibrations : sequence of Calibration
        At least two. Those that did not converge are left out, and the result says so.
    names : sequence of str, optional
        Names of the recordings in the result; default their numbers.
    between : bool
        True: values may vary between recordings beyond their sigmas. False: the parameters are the same in all of
        them.

    Returns
    -------
    Calibration
        Estimator "merged"; covariance of the unit's mean over the recordings, ``diagnostics.repeatability`` with the
        values of each, ``verdict.sequences`` with the recordings in place of sequences. U is kept if all
        recordings agree on it (the unit was mounted in the same way), otherwise None.

    Raises
    ------
    InputError
        Fewer than two; different units; one recording twice; calibrations that used a prior or are merged already.
    DataError
        If none converged.
    """
    require_type("Merging", "a list of calibrations", calibrations, Iterable)
    given = list(calibrations)
    for each in given:
        require_type("Merging", "calibrations (srt.calibrate, srt.load_calibration)", each, Calibration)
    titles = [str(n + 1) for n in range(len(given))] if names is None else list(names)
    check_members(given, titles)
    left_out = {t: c.status for t, c in zip(titles, given, strict=True) if c.status not in USABLE}
    used = {t: c for t, c in zip(titles, given, strict=True) if t not in left_out}
    if not used:
        raise DataError(
            "None of the calibrations can be merged: "
            + ", ".join(f"{title} is {status.replace('_', ' ')}" for title, status in left_out.items())
            + "."
        )
    members = list(used.values())
    stack = stack_estimates(members)
    sizes = between_sigma(stack) if between and len(members) > 1 else np.zeros(len(GROUP_SLICES))
    return _merged(used, left_out, stack, sizes)


def _merged(
    used: Mapping[str, Calibration], left_out: Mapping[str, str], stack: StackedEstimates, sizes: Array
) -> Calibration:
    members, titles = list(used.values()), list(used)
    seen = np.flatnonzero(stack.design.any(axis=0))
    X = stack.design[:, seen]
    within = stack.covariance
    scatter = np.diag(sizes[GROUP_OF[stack.parameter]] ** 2)
    values, weights, _ = estimate(stack.y, X, within + scatter)
    _, _, statistic = estimate(stack.y, X, within)
    freedom = len(stack.y) - len(seen)
    parts = {"recordings": stack.own, **stack.common, "between_recordings": scatter}
    by_source = {source: weights @ part @ weights.T for source, part in parts.items() if part.any()}
    covariance = np.zeros((N_PARAMETERS, N_PARAMETERS))
    covariance[np.ix_(seen, seen)] = sum(by_source.values())
    covariance = 0.5 * (covariance + covariance.T)
    vector = members[0].errors.vector.copy()
    vector[seen] = values
    observed = np.zeros(N_PARAMETERS, dtype=np.bool_)
    observed[seen] = True
    fixed = {name: members[0].fixed[name] for i, name in enumerate(NAMES) if not observed[i]}
    U, U_sigma, U_note = common_mounting(members)
    p_value = float(chdtrc(freedom, statistic)) if freedom else None
    unseen = tuple(dict.fromkeys(row for c in members for row in c.diagnostics.unseen_errors or ()))
    lacking = {name for c in members for name in c.diagnostics.not_shown or ()}
    merged = f"Merged from {len(members)} recording{'s' if len(members) > 1 else ''}."
    status, message = partial_or_converged(merged, fixed)
    return Calibration(
        estimator=ESTIMATOR,
        status=status,
        message=message,
        errors=SensorErrors(vector),
        covariance=covariance,
        fixed=fixed,
        contributions={source: _padded(np.sqrt(np.maximum(np.diag(P), 0.0)), seen) for source, P in by_source.items()},
        U=U,
        U_sigma_rad=U_sigma,
        site=shared_statements([c.site for c in members]),
        noise=NoiseFigures(between_recordings=dict(zip(GROUP_SLICES, sizes.tolist(), strict=True))),
        alignment=shared_statements([c.alignment for c in members]),
        temperature=whole_temperature(members),
        provenance=joint_provenance(members),
        diagnostics=Diagnostics(
            repeatability=repeatability(stack, used, left_out, vector, sizes, (statistic, freedom, p_value)),
            unseen_errors=unseen or None,
            not_shown=tuple(name for name in fixed if name in lacking) or None,
        ),
        consistency=replace(
            consistency(
                _recording_diagnostics(stack, within, within + scatter, titles, vector),
                covariance,
                observed,
                statistic,
                freedom,
            ),
            between_recordings=bool(sizes.any()),
            doubtful_recordings=tuple(title for title, c in used.items() if c.judgement.word == DOUBTFUL),
        ),
        warnings=_warnings(used, left_out, sizes, p_value, U_note),
    )


def _recording_diagnostics(
    stack: StackedEstimates, within: Array, total: Array, titles: Sequence[str], estimate_: Array
) -> tuple[SequenceDiagnostics, ...]:
    """Leave-one-out test of every recording, and the merged values from the others."""
    if len(titles) < 2:
        return ()
    groups = [stack.rows(r) for r in range(len(titles))]
    left, X = stack.y - stack.design @ estimate_, stack.design
    pairs = zip(
        titles, consistency_tests(left, X, within, groups), leave_one_out_estimates(left, X, total, groups), strict=True
    )
    return tuple(SequenceDiagnostics(title, 1, against, without) for title, against, without in pairs)


def _padded(values: Array, at: Indices) -> Array:
    out = np.zeros(N_PARAMETERS)
    out[at] = values
    return out


def require_names(titles: Sequence[str], count: int) -> None:
    """Raise InputError unless each of ``count`` recordings has a name of its own."""
    if len(titles) != count or len(set(titles)) != count:
        raise InputError(f"Each of the recordings needs its own name: {', '.join(titles)}.")


def check_members(calibrations: Sequence[Calibration], titles: Sequence[str], *, least: int = 2) -> None:
    """Refuse calibrations that are not of several independent recordings of one unit, ``least`` or more."""
    if len(calibrations) < least:
        raise InputError(f"At least two recordings of a unit are needed (given: {len(calibrations)}).")
    require_names(titles, len(calibrations))
    serials = {t: c.provenance.serial for t, c in zip(titles, calibrations, strict=True)}
    first = next((t for t in titles if serials[t] is not None), titles[0])
    for title, c in zip(titles, calibrations, strict=True):
        c.require_one_temperature()
        if c.estimator == ESTIMATOR:
            raise InputError(f"{title} is already merged: merge its recordings instead.")
        if c.provenance.options.get("prior") is not None:
            raise InputError(
                f"{title} was calibrated with a prior, which would count once per recording: "
                "calibrate it without a prior."
            )
        if serials[title] not in (None, serials[first]):
            raise InputError(
                f"These are different units: {first} has the serial {serials[first]}, {title} has {serials[title]}."
            )
    hashes: dict[str, str] = {}
    for title, c in zip(titles, calibrations, strict=True):
        data = c.provenance.data_sha256
        if data is not None and hashes.setdefault(data, title) != title:
            raise InputError(f"{hashes[data]} and {title} hold the same samples, which must not count twice.")


def common_mounting(members: Sequence[Calibration]) -> tuple[Array | None, float | None, str]:
    """Mean of U where all recordings agree on it, with a note where they do not."""
    found = [(c.U, c.U_sigma_rad) for c in members if c.U is not None and c.U_sigma_rad]
    if len(found) < len(members):
        note = "Not every recording has a table frame (U), and the merged calibration has none." if found else ""
        return None, None, note
    variance = np.array([sigma**2 for _, sigma in found if sigma is not None])
    turns = np.stack([U for U, _ in found if U is not None])
    left, _, right = np.linalg.svd(np.einsum("r,rab->ab", 1.0 / variance, turns))
    mean = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    away = np.sum(rotation_vector(mean.T @ turns) ** 2, axis=1)
    # U includes the levelling of each recording, in addition to the mounting.
    p_value = float(chdtrc(3 * (len(found) - 1), np.sum(away / (2.0 * variance)))) if len(found) > 1 else 1.0
    if p_value < UNLIKELY:
        return (
            None,
            None,
            (
                "The recordings disagree on the mounting of the unit on the table (U, by up to "
                f"{1e3 * float(np.sqrt(away.max())):.3g} mrad from their mean): the merged calibration has none."
            ),
        )
    return mean, float(np.sqrt(variance.max())), ""


def shared_statements(stated: Sequence[_Stated]) -> _Stated:
    """Values that are equal in all recordings; None for values that differ."""
    first = stated[0]
    names: list[str] = [f.name for f in fields(first) if f.name != "nulls"]
    differing: list[str] = [k for k in names if any(getattr(s, k) != getattr(first, k) for s in stated)]
    nulls = dict.fromkeys([*differing, *(key for s in stated for key in s.nulls)])
    return replace(first, **dict.fromkeys(differing), nulls=tuple(nulls))


def whole_temperature(members: Sequence[Calibration]) -> Temperature | None:
    """Mean over the recordings that state the value, and the range that includes all their means and ranges."""
    known = [c.temperature for c in members if c.temperature is not None]
    if not known:
        return None
    means = np.array([t.mean_c for t in known])
    half = 0.5 * np.array([t.range_c for t in known])
    return Temperature(float(means.mean()), float((means + half).max() - (means - half).min()))


def joint_provenance(members: Sequence[Calibration]) -> Provenance:
    """Origin of a result of several recordings: what they have in common, and each of them."""
    origins = [c.provenance for c in members]
    hashes = [origin.data_sha256 for origin in origins]
    whole = None if None in hashes else hashlib.sha256("".join(map(str, hashes)).encode()).hexdigest()
    dates, applied = {origin.date for origin in origins}, origins[0].applied
    return Provenance(
        data_sha256=whole,
        software=software(),
        serial=next((origin.serial for origin in origins if origin.serial is not None), None),
        date=dates.pop() if len(dates) == 1 else None,
        # The correction that all recordings had before they were logged.
        applied=applied if applied and all(origin.applied == applied for origin in origins) else None,
        recordings=tuple(origins),
    )


def _warnings(
    used: Mapping[str, Calibration], left_out: Mapping[str, str], sizes: Array, p_value: float | None, U_note: str
) -> tuple[str, ...]:
    said = [
        f"{title} is {status.replace('_', ' ')}, and was left out of the merged values."
        for title, status in left_out.items()
    ]
    if len(used) == 1:
        said.append("One recording alone is left: nothing is averaged, and the repeatability is unknown.")
    if p_value is not None and p_value < UNLIKELY:
        groups = [name.replace("_", " ") for name, size in zip(GROUP_SLICES, sizes, strict=True) if size > 0.0]
        said.append(
            "The recordings differ by more than their sigmas explain"
            + (f"; the scatter of {', '.join(groups)} from recording to recording is in the merged sigmas." if groups
               else ", and the merged sigmas do not include this.")
        )  # fmt: skip
    following = [title for title, c in used.items() if c.g_sensitivity is not None]
    if following:
        said.append(f"The gyro g-sensitivity is not merged: {', '.join(following)} have it.")
    nameless = [title for title, c in used.items() if c.provenance.serial is None]
    if nameless and len(used) > 1:
        said.append(f"No serial is given with {', '.join(nameless)}: one unit is assumed.")
    if len({c.site.gravity_m_s2 for c in used.values()}) > 1:
        said.append("The stated gravity differs between recordings: its errors are assumed independent.")
    return (*said, *([U_note] if U_note else []))
