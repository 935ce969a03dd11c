"""Calibrations for certificates, their files, and a reader of pages."""

from html.parser import HTMLParser

import numpy as np
from matplotlib.figure import Figure

import srt
from srt.reports.certificate import calibration_file
from srt.reports.certificate.figures import certificate_figures
from srt.result.calibration import Residual
from srt.result.consistency import Consistency
from srt.result.provenance import Alignment, Provenance, StatedSite, Temperature
from srt.sensor_errors import DISPLAY_FACTORS, NAMES, SensorErrors

COMPONENTS = ("horizontal_x", "horizontal_y", "start_down", "end_down")
FACTORS = np.array(DISPLAY_FACTORS)


def calibration(seed=1, held=(), sequences=3, **changes):
    """A calibration as an estimator would make it, with correlated errors."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((27, 60)) / FACTORS[:, None] / 8.0
    observed = np.array([name not in held for name in NAMES])
    given = {
        "estimator": "closed-form",
        "status": "partial" if held else "converged",
        "message": "Converged after 3 iterations.",
        "errors": SensorErrors(300.0 * rng.standard_normal(27) / FACTORS),
        "covariance": np.where(np.outer(observed, observed), root @ root.T, 0.0),
        "corrections": (1e-3, 1e-6, 1e-12),
        "fixed": dict.fromkeys(held, "held on request"),
        "U": np.eye(3),
        "U_sigma_rad": 1e-3,
        "residuals": tuple(
            Residual(str(k + 1), 1, c, float(rng.standard_normal()), 1.0) for k in range(sequences) for c in COMPONENTS
        ),
        "site": StatedSite(latitude_deg=45.0, gravity_m_s2=9.80665, gravity_sigma_m_s2=5e-6),
        "alignment": Alignment(fixture=True, alignment_sigma_mrad=1.0, rotation_sigma_mrad=1.0),
        "temperature": Temperature(23.25, 1.5),
        "provenance": Provenance(
            data_sha256=f"{seed:064x}",
            software="strapdown-rotation-test 0.1.0",
            serial="SN-1",
            date="2026-05-04",
            options={"hold": []},
        ),
        "consistency": Consistency(chi_square=44.0, degrees_of_freedom=44, probability=0.47),
    }
    return srt.Calibration(**(given | changes))


def saved_calibration(folder, result, name="unit.json"):
    """Save a calibration and read it as a certificate does."""
    result.save(folder / name)
    return calibration_file(folder / name)


class Reader(HTMLParser):
    """Tags, texts and the tables of a page."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.texts, self.tables, self.values = [], [], [], []
        self.inside = False
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
            self.values.append([])
        elif tag in ("td", "th"):
            self.tables[-1][-1].append("")
            self.inside = True
        elif tag == "data":
            self.values[-1].append(float(dict(attributes)["value"]))

    def handle_endtag(self, tag):
        self.inside = self.inside and tag not in ("td", "th")

    def handle_data(self, data):
        self.texts.append(data)
        if self.inside:
            self.tables[-1][-1][-1] += data.strip()

    def table(self, word):
        """Rows of the first table with a heading of its columns."""
        return next(table for table in self.tables if word in table[0])[1:]

    @property
    def text(self):
        return " ".join(" ".join(self.texts).split())


# Sentences of the certificate


def drawn(made, name):
    """The figure that a picture of the certificate draws."""
    figure = Figure()
    next(p for p in certificate_figures(made) if p.name == name).draw(made, figure)
    return figure
