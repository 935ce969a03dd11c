"""Outputs of the chain tests by name: each is made as a user makes it, and its values are compared with the file.

The file that ``srt calibrate -o`` writes is compared with the truth; all other outputs are compared with this file.
"""

import contextlib
import io
import json
import re
import traceback
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from chain_readers import Rows, html_rows, pdf_rows, text_rows
from chain_recordings import CASES, Case
from exporter_formulas import FORMULAS, SINGLE, TARGETS, biases_of, mm, motion
from scipy.stats import chi2
from test_loaders import HELD, LOADERS

import srt
from srt.cli import main
from srt.exporters import ExportSettings, Readings, export, exporter
from srt.exporters.applied_file import applied_of
from srt.sensor_errors import GROUP_SLICES

PAIRS = [(name, estimator) for name, case in CASES.items() for estimator in case.estimators]
TAIL = 0.01 / (2 * len(PAIRS))
"""Probability of a NEES beyond either limit: 1 % of a false alarm over all pairs and both sides."""
PRINTED = {
    "gyro_bias": np.degrees(1.0) * 3600.0,
    "accel_bias": 1e6 / 9.80665,
    **dict.fromkeys(("gyro_scale", "gyro_asymmetry", "gyro_orthogonality"), 1e6),
    **dict.fromkeys(("accel_scale", "accel_asymmetry", "accel_misalignment"), 1e6),
}
"""Units of tables (ppm, µrad, µg, °/h) per SI unit, by group."""
COARSE = {"gyro_bias": (3600.0, 1000.0), "accel_bias": (1000.0, 10_000.0)}
"""In reports: size of °/s and mg in these units, and the largest value of the group from which on they are used."""
SINGLE_PRECISION = ("vectornav", "px4", "ardupilot")


@dataclass(frozen=True)
class Run:
    """Exit code and streams of a command; a traceback stands in ``err``, with the code -1."""

    code: int
    out: str
    err: str


def srt_command(*arguments: object) -> Run:
    """Run a command in this process."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main([str(each) for each in arguments])
        except Exception:
            err.write(traceback.format_exc())
            code = -1
    return Run(code, out.getvalue(), err.getvalue())


def good(run: Run) -> Run:
    """The run, if it succeeded and accuses nobody."""
    assert run.code == 0, f"exit {run.code}: {run.err[-3000:]}"
    assert "Traceback" not in run.err
    assert "edited" not in run.err
    return run


class Chain:
    """A recording, its truth, and the files that were made of it; ``pictures``: draw what takes most of the time."""

    pictures = False

    def __init__(self, name: str, folder: Path) -> None:
        self.name, self.folder = name, folder
        self.case: Case = CASES[name]
        self.recording = folder / "recording"
        self.truth = self.case.make(name, self.recording)
        self._runs: dict[str, Run] = {}
        self._documents: dict[str, dict[str, Any]] = {}
        self._calibrations: dict[str, srt.Calibration] = {}

    def calibrated(self, estimator: str) -> Run:
        """Result of ``srt calibrate -o``, run once."""
        if estimator not in self._runs:
            self._runs[estimator] = srt_command(
                "calibrate", self.recording, "--estimator", estimator, "-o", self.file(estimator)
            )
        return good(self._runs[estimator])

    def file(self, estimator: str, ending: str = ".json") -> Path:
        """Path of a file of one estimator."""
        return self.folder / f"{estimator}{ending}"

    def document(self, estimator: str) -> dict[str, Any]:
        """Result as JSON, read strictly and once: NaN and infinity are no JSON."""
        if estimator not in self._documents:
            self.calibrated(estimator)
            text = self.file(estimator).read_text(encoding="utf-8")
            self._documents[estimator] = json.loads(text, parse_constant=_no_number)
        return self._documents[estimator]

    def calibration(self, estimator: str) -> srt.Calibration:
        """The saved result, loaded once."""
        if estimator not in self._calibrations:
            self.calibrated(estimator)
            self._calibrations[estimator] = srt.load_calibration(self.file(estimator))
        return self._calibrations[estimator]

    @cached_property
    def findings(self) -> set[str]:
        """Faults that ``srt inspect`` finds in the recording."""
        return _findings(self.recording, self.folder / "inspection.json")


def _no_number(word: str) -> None:
    raise AssertionError(f"{word} is no JSON")


def _findings(recording: Path, output: Path) -> set[str]:
    good(srt_command("inspect", recording, "-o", output, "-q"))
    return {found["fault"] for found in json.loads(output.read_text())["findings"]}


def values(document: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Values and sigmas (NaN: fixed), shape (27,) each, SI."""
    rows = document["parameters"]
    return np.array([r["value"] for r in rows]), np.array([np.nan if r["sigma"] is None else r["sigma"] for r in rows])


def printed_units() -> np.ndarray:
    """Factors from SI to the units of tables, shape (27,)."""
    return np.array([PRINTED[name.rpartition("_")[0]] for name in srt.NAMES])


def report_units(document: dict[str, Any]) -> np.ndarray:
    """Factors from SI to the units of a report of these values, shape (27,)."""
    factors = printed_units()
    sizes = np.nan_to_num(np.abs(values(document)[0].astype(float))) * factors
    for group, (size, limit) in COARSE.items():
        own = np.array([name.rpartition("_")[0] == group for name in srt.NAMES])
        factors[own] /= size if sizes[own].max() >= limit else 1.0
    return factors


def agree(rows: Rows, document: dict[str, Any]) -> None:
    """Printed values and sigmas are those of the file, to half a unit of their last digit."""
    assert list(rows) == list(srt.NAMES)
    factors = report_units(document)
    for (value, sigma), row, factor in zip(rows.values(), document["parameters"], factors, strict=True):
        assert (sigma == "fixed") == (row["sigma"] is None), row["name"]
        for text, number in ((value, row["value"]), (sigma, row["sigma"])):
            if text != "fixed":
                half = 0.5 * 10.0 ** -len(text.partition(".")[2])
                assert abs(float(text) - number * factor) <= half * (1.0 + 1e-9), (row["name"], text, number * factor)


def nees(document: dict[str, Any], truth: np.ndarray) -> tuple[float, int]:
    """Normalised estimation error squared of the observed parameters, and their number."""
    value, sigma = values(document)
    seen = ~np.isnan(sigma)
    scaled = np.array(document["covariance"])[np.ix_(seen, seen)] / np.outer(sigma[seen], sigma[seen])
    error = (value - truth)[seen] / sigma[seen]
    return float(error @ np.linalg.solve(scaled, error)), int(seen.sum())


def json_file(chain: Chain, estimator: str) -> None:
    """Strict JSON that loads and saves unchanged, with errors that agree with the covariance."""
    document = chain.document(estimator)
    again = chain.file(estimator, "-again.json")
    chain.calibration(estimator).save(again)
    assert json.loads(again.read_text(encoding="utf-8")) == document
    assert document["estimator"] == estimator
    seen = {row["name"] for row in document["parameters"] if row["observed"]}
    for warning in document["warnings"]:
        if "cannot be estimated" in warning:
            assert not seen & set(re.findall(r"\w+", warning)), warning
    chi, n = nees(document, chain.truth)
    assert n > 0
    assert chi < chi2.isf(TAIL, n)
    if chain.case.known and n == len(chain.truth):
        # Fixed parameters enter the sigmas by priors wider than these units, and so does noise that is not stated.
        assert chi > chi2.ppf(TAIL, n)


def text(chain: Chain, estimator: str) -> None:
    """Summary on the terminal: table, status and count of the file."""
    shown, document = chain.calibrated(estimator).out, chain.document(estimator)
    agree(text_rows(shown), document)
    words = " ".join(shown.split())
    assert document["message"].partition(". ")[0] in words
    assert document["verdict"]["reason"] in words
    fixed = sum(row["sigma"] is None for row in document["parameters"])
    assert (document["status"] == "partial") == (fixed > 0)


def html_repr(chain: Chain, estimator: str) -> None:
    """Table of a notebook."""
    agree(html_rows(chain.calibration(estimator)._repr_html_()), chain.document(estimator))


def frame(chain: Chain, estimator: str) -> None:
    """Table of pandas."""
    table = srt.to_frame(chain.calibration(estimator))
    value, sigma = values(chain.document(estimator))
    assert list(table.index) == list(srt.NAMES)
    # Two products of rounded factors.
    np.testing.assert_allclose(table["value"], value * printed_units(), rtol=1e-14)
    np.testing.assert_allclose(table["sigma"], sigma * printed_units(), rtol=1e-14)


def figure(chain: Chain, estimator: str) -> None:
    """Figure of a calibration with every value; in the slow form, its file too."""
    path = chain.file(estimator, ".png")
    made = srt.plot(chain.calibration(estimator), path if chain.pictures else None)
    value, _ = values(chain.document(estimator))
    drawn = {float(y) for axes in made.get_axes() for line in axes.lines for y in np.atleast_1d(line.get_ydata())}
    close = np.array(sorted(drawn))
    for name, wanted in zip(srt.NAMES, value * report_units(chain.document(estimator)), strict=True):
        assert np.abs(close - wanted).min() <= 1e-12 * abs(wanted), name
    assert not chain.pictures or path.read_bytes().startswith(b"\x89PNG")


def certificate(chain: Chain, estimator: str) -> None:
    """Page and PDF of a calibration with its recording."""
    document, page = chain.document(estimator), chain.file(estimator, ".html")
    good(srt_command("certificate", chain.file(estimator), chain.recording, "-o", page, "-q"))
    agree(html_rows(page.read_text(encoding="utf-8")), document)
    agree(pdf_rows(page.with_suffix(".pdf")), document)


def compare(chain: Chain, estimator: str) -> None:
    """Comparison with another estimator: the values are those of the single results, and the difference is theirs."""
    other = "least-squares" if estimator != "least-squares" else "graph"
    output = chain.file(estimator, "-comparison.json")
    arguments = [part for each in (estimator, other) for part in ("--estimator", each)]
    good(srt_command("compare", chain.recording, *arguments, "-o", output, "-q"))
    compared = json.loads(output.read_text(encoding="utf-8"), parse_constant=_no_number)
    assert compared["agree"] is True
    rows = {row["name"]: row for row in compared["estimators"]}
    single = {each: values(chain.document(each)) for each in (estimator, other)}
    for each, (value, sigma) in single.items():
        np.testing.assert_array_equal(rows[each]["value"], value)
        np.testing.assert_array_equal(np.array(rows[each]["sigma"], dtype=float), sigma)
    (name,) = set(single) - {compared["reference"]}
    value, reference = single[name][0], single[compared["reference"]][0]
    difference = np.array(rows[name]["comparison"]["difference"], dtype=float)
    both = ~np.isnan(difference)
    assert both.sum() == rows[name]["comparison"]["compared"] > 0
    # A difference of two doubles, each rounded once.
    size = 4e-16 * (np.abs(value) + np.abs(reference))
    assert np.all(np.abs(difference - (value - reference))[both] <= size[both])


def applied(chain: Chain, estimator: str) -> None:
    """Corrected recording: no new fault, and its own calibration finds errors within a sigma of zero."""
    chain.calibrated(estimator)
    folder = chain.file(estimator, "-corrected")
    good(srt_command("apply", chain.file(estimator), chain.recording, "-o", folder, "-q"))
    found = _findings(folder, chain.file(estimator, "-inspection.json"))
    assert not found or found <= chain.findings
    again = srt.calibrate(srt.load_recording(folder), estimator, checks=False)
    assert again.status in ("converged", "partial"), again.message
    seen = again.observed
    left = np.abs(again.errors.vector[seen]) / again.sigma[seen]
    assert left.max() < 1.0, [(srt.NAMES[i], x) for i, x in zip(np.flatnonzero(seen), left, strict=True) if x >= 1.0]


def exported(target: str, chain: Chain, estimator: str) -> None:
    """File of another tool, applied by the tool itself or by its formula: the correction of the calibration."""
    calibration, raw = chain.calibration(estimator), motion(np.random.default_rng(0))
    path = chain.file(estimator, f"-{target}{exporter(target).suffixes[0]}")
    replaces = bool(exporter(target).find_applied)
    more = ("--applied", "none") if replaces else ()
    good(srt_command("export", chain.file(estimator), "--to", target, "-o", path, "-q", *more))
    parts = {part: path.with_name(f"{path.stem}{part}{path.suffix}") for part in exporter(target).parts}
    load = LOADERS[target][1]
    if load is None:
        texts = {part: place.read_bytes().decode() for part, place in parts.items()}
        found = FORMULAS[target](texts, raw.gyro, raw.accel, biases_of(calibration))
    else:
        found = load([*parts.values()], raw.gyro, raw.accel, calibration)
    made = export(calibration, target, settings=ExportSettings(), applied=applied_of("none") if replaces else None)
    expected = [mm(made.C_FB, v) for v in representable(calibration, target, raw)]
    worst = max(float(np.abs(a - b).max()) for a, b in zip(found, expected, strict=True))
    # Twelve constants of at most 1.1 times readings of 33 m/s² on three axes, in single or in double precision.
    assert worst < 12 * 3 * 1.1 * 33.0 * (SINGLE if target in SINGLE_PRECISION else 2.0**-53), worst


def representable(calibration: srt.Calibration, target: str, raw: Readings) -> list[np.ndarray]:
    """Readings corrected by as much of a calibration as the format holds, gyros and accelerometers, shape (n, 3)."""
    kept = np.ones(len(srt.NAMES))
    if not exporter(target).asymmetry:
        kept[GROUP_SLICES["gyro_asymmetry"]] = kept[GROUP_SLICES["accel_asymmetry"]] = 0.0
    linear = replace(calibration, errors=srt.SensorErrors(calibration.errors.vector * kept))
    if target not in HELD:
        return list(linear.apply(raw.gyro, raw.accel))
    out = []
    for i, sensor in enumerate(("gyro", "accel")):
        bias = calibration.errors.group(f"{sensor}_bias")
        # Columns of M⁻¹ are differences of corrected readings; row m of M and the factor s have the least |s m − e_i|.
        probes = np.vstack([np.zeros(3), np.eye(3)]) + bias
        corrected = linear.apply(*(probes if j == i else np.zeros((4, 3)) for j in range(2)))[i]
        matrix = np.linalg.inv((corrected[1:] - corrected[0]).T)
        factor = np.diag(matrix) / np.sum(matrix**2, axis=1) if f"{sensor}_scale" in HELD[target] else 1.0
        out.append(((raw.gyro, raw.accel)[i] - bias) * factor)
    return out


CHEAP: dict[str, Callable[[Chain, str], None]] = {"json": json_file, "text": text, "html": html_repr, "frame": frame}
"""Outputs that follow from the saved file in milliseconds: tested for every pair of recording and estimator."""
OUTPUTS: dict[str, Callable[[Chain, str], None]] = {
    "certificate": certificate,
    "compare": compare,
    "apply": applied,
    "figure": figure,
    **{f"export-{target}": partial(exported, target) for target in TARGETS},
}


def applies(name: str, output: str) -> bool:
    """False for a comparison of a recording that one estimator alone takes."""
    return output != "compare" or len(CASES[name].estimators) > 1


PRODUCT = [(name, each, output) for name, each in PAIRS for output in (*CHEAP, *OUTPUTS) if applies(name, output)]
"""Every recording, estimator and output."""


@lru_cache
def covering() -> frozenset[tuple[str, str, str]]:
    """Part of the product in which every pair occurs: the estimators take turns over recordings and outputs."""
    chosen = {(name, each, output) for name, each, output in PRODUCT if output in CHEAP}
    for i, (name, case) in enumerate(CASES.items()):
        for j, output in enumerate(OUTPUTS):
            chosen.add((name, case.estimators[(i + j) % len(case.estimators)], output))
    return frozenset(chosen & set(PRODUCT))


@lru_cache
def twentieth() -> frozenset[tuple[str, str, str]]:
    """Part of the rest: of one estimator for each recording, in turns, the two outputs that occur least so far."""
    chosen: list[tuple[str, str, str]] = []
    for i, (name, case) in enumerate(CASES.items()):
        taken = Counter(output for *_, output in chosen)
        pair = (name, case.estimators[(i + i // 2 + 1) % len(case.estimators)])
        own = [each for each in PRODUCT if each[:2] == pair and each not in covering()]
        chosen += sorted(own, key=lambda each: taken[each[2]])[:2]
    return frozenset(chosen)
