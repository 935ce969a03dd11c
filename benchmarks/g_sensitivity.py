"""A MEMS unit of 0.5 °/s bias and 30 °/h/g: what three ways to take the gyro bias off leave, predicted and observed.

``python benchmarks/g_sensitivity.py --units 2500`` prints the table of docs/g-sensitivity.md.
"""

import argparse

from sims.accuracy.g_sensitivity import MODES, mems_scenario, study
from srt.constants import DEG_PER_H
from srt.sensor_errors import DISPLAY_FACTORS, DISPLAY_UNITS, NAMES, SYMBOLS


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--units", type=int, default=300)
    parser.add_argument("--seed", type=int, default=5000)
    parser.add_argument("--dwell", type=float, default=4.0, metavar="S", help="of each window")
    parser.add_argument("--rate", type=float, default=50.0, metavar="HZ")
    arguments = parser.parse_args()
    plan = mems_scenario(dwell_s=arguments.dwell, sample_rate_hz=arguments.rate)
    found = study(plan, arguments.units, first_seed=arguments.seed)

    def row(name: str, unit: str, pairs: list[tuple[float, float]]) -> None:
        cells = [f"{p:.3g} | {o:.3g} | {p / o:.3f}" for p, o in pairs]
        print(f"| {name} | {unit} | {' | '.join(cells)} |")

    print("| | unit |" + "".join(f" {mode}: predicted | observed | ratio |" for mode in MODES))
    print("|---|---|" + "---:|---:|---:|" * len(MODES))
    left = [(found[m].left_predicted / DEG_PER_H, found[m].left_observed / DEG_PER_H) for m in MODES]
    row("bias left at rest", "°/h", left)
    for i in range(len(NAMES)):
        sizes = [(float(found[m].predicted.total[i]), float(found[m].observed[i])) for m in MODES]
        row(SYMBOLS[i], DISPLAY_UNITS[i], [(DISPLAY_FACTORS[i] * p, DISPLAY_FACTORS[i] * o) for p, o in sizes])
    print(f"\nSquared error of the g-sensitivity over its covariance, by nine: {found['g-sensitive'].nees:.3f}")


if __name__ == "__main__":
    main()
