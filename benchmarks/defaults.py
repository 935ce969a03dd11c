"""Figures for the choice of the default options: noise-free error and noise sigma of every alternative.

``python benchmarks/defaults.py`` prints the table of docs/design/defaults.md.
"""

import argparse
from functools import partial

import accuracy_trials
import numpy as np
from rich.console import Console
from rich.table import Table

from srt.sensor_errors import GROUP_SLICES

ALTERNATIVES = (
    {},
    {"average": "overlapping"},
    {"down": "paper"},
    {"window_attitude": "integrated"},
    {"gyro_bias": "pooled"},
    {"gyro_bias": "per-sequence"},
    {"step": "coefficients", "max_playbacks": 20},
    {"measured_vertical": False},
    {"measured_vertical": False, "down": "paper"},
)
SHOWN = {
    "κ": "gyro_scale",
    "υ": "gyro_orthogonality",
    "λ": "accel_bias",
    "λii": "accel_scale",
    "μ": "accel_misalignment",
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=60)
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    table = Table(title=f"options against the default, {arguments.draws} draws each")
    for column in ("option", "1 mrad", "10 mrad", "λii 10 mrad", "iterations", *SHOWN, "NEES/27"):
        table.add_column(column)
    for choice in ALTERNATIVES:
        one, ten = (
            accuracy_trials.run(
                partial(accuracy_trials.fixture_trial, sigma_rad=s, **choice),
                range(arguments.draws),
                workers=arguments.workers,
            )
            for s in (1e-3, 1e-2)
        )
        noisy = accuracy_trials.run(
            partial(accuracy_trials.noisy_trial, grade="navigation", calibration=choice),
            range(1000, 1000 + arguments.draws),
            workers=arguments.workers,
        )
        rms = np.sqrt(np.mean([t.error**2 for t in noisy], axis=0))
        table.add_row(
            ", ".join(f"{k}={v}" for k, v in choice.items() if k != "max_playbacks") or "default",
            f"{max(np.abs(t.error[:24]).max() for t in one):.1e}",
            f"{max(np.abs(t.error[:24]).max() for t in ten):.1e}",
            f"{max(np.abs(t.error[GROUP_SLICES['accel_scale']]).max() for t in ten):.1e}",
            f"{max(t.playbacks for t in one)}",
            *(f"{np.sqrt(np.mean(rms[GROUP_SLICES[g]] ** 2)) * 1e6:.2f}" for g in SHOWN.values()),
            f"{np.mean([t.nees for t in noisy]):.2f}",
        )
    Console(width=140).print(table)


if __name__ == "__main__":
    main()
