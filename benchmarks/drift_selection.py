"""Drift selected in recordings without drift: units of three grades on a 1 mrad fixture, bias instability as specified.

``python benchmarks/drift_selection.py --units 300``: at most one recording in 50,000 may select a form by design.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter

from accuracy_trials import GRADES, noisy_recording
from joblib import Parallel, delayed
from scipy.stats import binom

import srt
from srt.noise.drift_forms import FALSE_ALARM

FIRST_SEED = 500_000


def selected(seed: int, estimator: str) -> tuple[str, ...]:
    """Sensors and forms that one unit selects."""
    grade = tuple(GRADES)[seed % len(GRADES)]
    recording, _ = noisy_recording(FIRST_SEED + seed, grade, sample_rate_hz=20.0, instability=True)
    found = srt.calibrate(recording, estimator, checks=False).diagnostics.drift or ()
    return tuple(f"{grade}, {term.sensor}: {term.form}" for term in found)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--units", type=int, default=300)
    parser.add_argument("--estimator", default="least-squares")
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    found = Parallel(n_jobs=options.jobs)(delayed(selected)(u, options.estimator) for u in range(options.units))
    wrong = [forms for forms in found if forms]
    limit = int(binom.isf(1e-3, options.units, FALSE_ALARM))
    print(f"{options.estimator}: {len(wrong)} of {options.units} units select a drift, {limit} allowed")
    for forms, count in Counter(wrong).most_common():
        print(f"  {count}: {'; '.join(forms)}")
    return int(len(wrong) > limit)


if __name__ == "__main__":
    sys.exit(main())
