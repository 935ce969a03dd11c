"""Table 1 on a faultless fixture without Earth's rate: constants of its run, and its derivatives."""

import math
from dataclasses import dataclass, field
from functools import cache

import numpy as np

import sims
from srt.estimation.options import Options
from srt.estimation.srt_measurements import SrtProcessor
from srt.model.table1 import SEQUENCES
from srt.recording.recording import Site
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS
from srt.sequences.preparation import PreparedRecording, prepare

G = 9.80665
WINDOW_S = 2.0
RAMP_S = 1e-4
SAMPLE_RATE_HZ = 100.0
RATE_RAD_S = 0.5 * math.pi / (157 / SAMPLE_RATE_HZ - RAMP_S)
"""A quarter turn with its ramp takes 157 samples, every longer one a little less than a whole number of them."""

STEPS = np.full(N_PARAMETERS, 1e-6)
STEPS[GROUP_SLICES["accel_bias"]] = 1e-5
"""Half the central difference, SI: small beside what the third derivative would need to show (about 1e-10 of a
coefficient), large beside rounding (1e-16 · g / 1e-6 = 1e-10 of g)."""


def paused_table_1(dwell_s, pause_s=0.1, sequences=tuple(sims.TABLE_1), **run):
    """Motion by sequences of Table 1 at 1 rad/s, with pauses: no sample holds parts of two rotations."""
    schedule = sims.Schedule(
        sims.table_sequences(tuple(sequences)), sims.RateProfile(1.0, 10.0), dwell_s=dwell_s, leg_dwell_s=pause_s
    )
    return sims.run_schedule(schedule, **run)


@cache
def ideal_motion():
    """Table 1 on a faultless fixture that does not turn with the Earth."""
    rates = {"rate_rad_s": RATE_RAD_S, "accel_rad_s2": RATE_RAD_S / RAMP_S}
    return sims.table1_motion(site=Site(G), dwell_s=WINDOW_S, sample_rate_hz=SAMPLE_RATE_HZ, earth_rate=False, **rates)


@dataclass(frozen=True)
class Simulated:
    """Table 1 executed by the simulator on a faultless fixture without Earth's rate, and played back at zero errors.

    ``J`` is dz/d(error in the data) by central differences over all 27 errors.
    """

    data: PreparedRecording
    z: np.ndarray
    J: np.ndarray
    rows: dict[tuple[str, str], int] = field(default_factory=dict)

    def row(self, sequence: str, component: str) -> np.ndarray:
        """Derivative of one component: "x", "y", "z" of Δa_H, or "start", "end" for Down."""
        return self.J[self.rows[sequence, component]]

    @staticmethod
    def tolerance(sequence: str) -> np.ndarray:
        """Largest difference of a component of a sequence from the ideal one, for each parameter.

        A rotation ends inside a sample of length dt, where the next one may begin: the sum over that sample
        then hides a non-commutation of at most (β̇ dt/2)²/2 rad, twice that per unit of scale error. Each
        rotation's ramps, and the rest of its last sample, add up to two ramps' time, over which a bias acts.
        """
        rotations = len(SEQUENCES[sequence].rotations)
        out = np.full(N_PARAMETERS, G * rotations * (0.5 * RATE_RAD_S / SAMPLE_RATE_HZ) ** 2)
        out[GROUP_SLICES["gyro_bias"]] = G * (rotations + 4) * RAMP_S
        out += 1e-9 * G  # rounding in the difference
        return out


def player_of(recording, **options):
    """Prepared recording and its processor."""
    chosen = Options(**options)
    data = prepare(recording, recording.sequences, chosen.average)
    integrated = np.full(len(data.windows.duration_s), chosen.window_attitude == "integrated")
    return data, SrtProcessor(data, chosen, integrated)


def component_rows(data: PreparedRecording) -> dict[tuple[str, str], int]:
    """Place of every measured component in z."""
    rows = {}
    for k, name in enumerate(data.ids):
        horizontal = [a for a in "xyz" if a != data.catalogue[k].down]
        rows |= {(name, a): 2 * k + i for i, a in enumerate(horizontal)}
        rows |= {
            (name, "start"): 2 * data.K + int(data.start[k]),
            (name, "end"): 2 * data.K + int(data.end[k]),
        }
    return rows
