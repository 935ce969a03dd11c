"""A campaign of short trials, and its numbers, for the tests of campaigns."""

import json

from sims.robustness.campaign import load_campaign

TIMES = ("simulate_s", "calibrate_s")
SMALL = """
[campaign]
name = "small"
seed = 7
trials = {trials}

[scenario]
from = "robustness"
{scenario}
[scenario.errors]
draw = "uniform"
factor = 1.0

[scenario.schedule]
dwell_s = 2.0
rate_rad_s = 2.0

[scenario.recording]
sample_rate_hz = 50.0

[grid]
scale_percent = [5, 50]
misalignment_mrad = [30]

[random]
gyro_bias_deg_s = {{ low = 0.0, high = 1.0 }}
{extra}
[[estimator]]
name = "closed-form"
"""


def small_campaign(folder, trials=2, extra="", scenario="", text=SMALL):
    path = folder / "small.toml"
    path.write_text(text.format(trials=trials, extra=extra, scenario=scenario))
    return load_campaign(path)


def numbers(table):
    return table.drop_columns(TIMES).to_pylist()


def same(a, b):
    """Equal to the last bit, NaN to NaN."""
    return json.dumps(numbers(a)) == json.dumps(numbers(b))
