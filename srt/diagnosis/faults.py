"""The catalogue of faults: what can be wrong with a recording, in the order in which one fault explains another.

A fault higher in the table makes those below it appear: degrees taken for radians also look like clipping, a lost
sample like a wrong angle. The first finding by this order is therefore named as the cause.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

Effect = Literal["exit 2", "exit 1", "warning", "note"]
"""Refused on reading; refused by calibration; calibrated with a warning; only told by ``srt inspect``."""

STAGES: Final = {
    "file": "What reading refuses",
    "timing": "Time stamps",
    "channels": "Channels and logger",
    "units": "Units, scales and ranges",
    "frames": "Axes and frames",
    "sequences": "Sequences and labels",
    "windows": "Stillness",
    "motion": "Rotation",
    "site": "Place",
    "unit": "The unit itself",
}


@dataclass(frozen=True, slots=True)
class Fault:
    """One thing that can be wrong.

    Attributes
    ----------
    name : str
        Short and stable, for scripts.
    stage : str
        Key of :data:`STAGES`.
    title : str
        In a few words.
    looks_at : str
        What tells it.
    sentence : str
        What is said, with fields in braces that the finding fills: what was found, where, what is expected, what to do.
    effect : Effect
    """

    name: str
    stage: str
    title: str
    looks_at: str
    sentence: str
    effect: Effect


_ROWS: Final = (
    # --- file: raised by reading, named here -------------------------------------------------------------------------
    (
        "not_finite",
        "file",
        "A reading is no number",
        "every sample",
        "{message}",
        "exit 2",
    ),
    (
        "time_backwards",
        "file",
        "Time runs backwards",
        "steps of the time stamps",
        "{message}",
        "exit 2",
    ),
    (
        "time_repeats",
        "file",
        "A time stamp repeats",
        "steps of the time stamps",
        "{message}",
        "exit 2",
    ),
    (
        "rate_contradicts_stamps",
        "file",
        "The stated sample rate contradicts the stamps",
        "sample_rate_hz against the mean step of the stamps",
        "{message}",
        "exit 2",
    ),
    # --- timing ------------------------------------------------------------------------------------------------------
    (
        "time_unit",
        "timing",
        "Wrong time unit",
        "the sampling interval, which is 5 µs to 0.5 s for an IMU; turns and gravity, if both are off like it",
        "The samples are {interval:.3g} s apart, {why}: the time stamps look like {unit}, declared as {declared}; "
        "correct time_unit in recording.toml.",
        "exit 1",
    ),
    (
        "stamp_jitter",
        "timing",
        "Time stamps jitter",
        "scatter of the steps against an even rate",
        "The time stamps jitter by {jitter:.2g} of the sampling interval ({interval:.4g} s), so every rotation angle "
        "takes that scatter in: state sample_rate_hz if the unit samples evenly, or log the unit's own clock.",
        "warning",
    ),
    (
        "gap_in_sequence",
        "timing",
        "Samples are missing inside a sequence",
        "steps of the stamps between the windows of a sequence",
        "{title}: samples are missing for {duration:.3g} s before {time:.6g} s, inside the sequence{more}, which is "
        "void: repeat it.",
        "warning",
    ),
    # --- channels ----------------------------------------------------------------------------------------------------
    (
        "gyro_channel_dead",
        "channels",
        "A gyro column never changes",
        "range of every gyro column",
        "Column {channel} reads {value:g} in all samples, but its axis was turned: connect the sensor, or name the "
        "right column.",
        "exit 1",
    ),
    (
        "accel_channel_dead",
        "channels",
        "An accelerometer column never changes",
        "range of every accelerometer column",
        "Column {channel} reads {value:g} in all samples, but the unit was turned over: connect the sensor, or "
        "name the "
        "right column.",
        "exit 1",
    ),
    (
        "columns_repeat",
        "channels",
        "Two columns hold the same readings",
        "every pair of columns",
        "Columns {channel} and {other} hold the same readings: one of them is named twice; correct the mapping of the "
        "columns.",
        "exit 1",
    ),
    (
        "sensors_exchanged",
        "channels",
        "Gyro and accelerometer columns are exchanged",
        "which triad holds gravity at rest, and which is zero there",
        "At rest the gyro columns read {gyro:.3g} and the accelerometer columns {accel:.3g} (SI), as if exchanged: "
        "correct the mapping of the columns.",
        "exit 1",
    ),
    (
        "samples_stuck",
        "channels",
        "The logger repeats samples",
        "rows that repeat in all six channels, against how often noise repeats",
        "All six channels repeat for {count} samples from {time:.6g} s, as when a logger stalls: repeat "
        "{sequence}, or leave it out.",
        "warning",
    ),
    (
        "gyro_stuck",
        "channels",
        "The gyros freeze for a while",
        "gyro rows that repeat while the accelerometers go on",
        "The gyros repeat one reading for {count} samples from {time:.6g} s while the accelerometers go on: repeat "
        "{sequence}, or leave it out.",
        "warning",
    ),
    (
        "accel_stuck",
        "channels",
        "The accelerometers freeze for a while",
        "accelerometer rows that repeat while the gyros go on",
        "The accelerometers repeat one reading for {count} samples from {time:.6g} s while the gyros go on: repeat "
        "{sequence}, or leave it out.",
        "warning",
    ),
    (
        "spikes",
        "channels",
        "Single readings jump out",
        "every reading against its neighbours, by the noise around it",
        "{channel} jumps by {size} for one sample at {time:.6g} s ({count} such readings in all), far beyond its "
        "noise: look for a bad contact or transmission errors, and repeat {sequence}.",
        "warning",
    ),
    # --- units -------------------------------------------------------------------------------------------------------
    (
        "increments_as_rates",
        "units",
        "Increments declared as rates",
        "gravity at rest and the stated turns, both against the sampling interval",
        "At rest the accelerometers read {accel:.4g} m/s² and turns come out {turn:.3g} times as large as stated, the "
        'sampling interval ({interval:.3g} s) times what is right: the values are increments; set kind = "increment".',
        "exit 1",
    ),
    (
        "rates_as_increments",
        "units",
        "Rates declared as increments",
        "gravity at rest and the stated turns, both against the sampling interval",
        "At rest the accelerometers read {accel:.4g} m/s² and turns come out {turn:.3g} times as large as stated, what "
        'is right divided by the sampling interval ({interval:.3g} s): the values are rates; set kind = "rate".',
        "exit 1",
    ),
    (
        "gyro_degrees",
        "units",
        "Gyro readings in degrees, declared in radians",
        "turned angles against those stated",
        "Turns come out {ratio:.4g} times as large as stated ({title}): the gyro readings look like {unit}, "
        "declared as "
        "{declared}; correct gyro_unit.",
        "exit 1",
    ),
    (
        "gyro_radians",
        "units",
        "Gyro readings in radians, declared in degrees",
        "turned angles against those stated",
        "Turns come out {ratio:.4g} times as large as stated ({title}): the gyro readings look like {unit}, "
        "declared as "
        "{declared}; correct gyro_unit.",
        "exit 1",
    ),
    (
        "gyro_per_hour",
        "units",
        "Gyro readings per hour, declared per second, or the other way round",
        "turned angles against those stated",
        "Turns come out {ratio:.4g} times as large as stated ({title}): the gyro readings look like {unit}, "
        "declared as "
        "{declared}; correct gyro_unit.",
        "exit 1",
    ),
    (
        "gyro_counts",
        "units",
        "Gyro counts declared as a unit",
        "turned angles against those stated; whole numbers",
        "Turns come out {ratio:.4g} times as large as stated ({title}), and the gyro readings are whole numbers: they "
        'look like raw counts; set gyro_unit = "counts" and gyro_lsb.',
        "exit 1",
    ),
    (
        "accel_g",
        "units",
        "Accelerometer readings in g, declared in m/s²",
        "specific force at rest against gravity",
        "At rest the accelerometers read {found:.4g} m/s² where {expected:.4g} is expected: the readings look like "
        "{unit}, declared as {declared}; correct accel_unit.",
        "exit 1",
    ),
    (
        "accel_mg",
        "units",
        "Accelerometer readings in mg, declared otherwise",
        "specific force at rest against gravity",
        "At rest the accelerometers read {found:.4g} m/s² where {expected:.4g} is expected: the readings look like "
        "{unit}, declared as {declared}; correct accel_unit.",
        "exit 1",
    ),
    (
        "accel_m_s2",
        "units",
        "Accelerometer readings in m/s², declared in g",
        "specific force at rest against gravity",
        "At rest the accelerometers read {found:.4g} m/s² where {expected:.4g} is expected: the readings look like "
        "{unit}, declared as {declared}; correct accel_unit.",
        "exit 1",
    ),
    (
        "accel_counts",
        "units",
        "Accelerometer counts declared as a unit",
        "specific force at rest against gravity; whole numbers",
        "At rest the accelerometers read {found:.4g} m/s² where {expected:.4g} is expected, and the readings are whole "
        'numbers: they look like raw counts; set accel_unit = "counts" and accel_lsb.',
        "exit 1",
    ),
    (
        "gyro_lsb",
        "units",
        "Wrong value of a gyro count, or of the gyro range",
        "turned angles against those stated, alike on all axes, by a power of two",
        "All gyro axes read {ratio:.4g} times what was turned, near {power:g}: the value of a count belongs to another "
        "range of the unit; correct gyro_lsb.",
        "exit 1",
    ),
    (
        "accel_lsb",
        "units",
        "Wrong value of an accelerometer count, or of the accelerometer range",
        "specific force at rest against gravity, alike on all axes, by a power of two",
        "All accelerometer axes read {ratio:.4g} times gravity, near {power:g}: the value of a count belongs "
        "to another "
        "range of the unit; correct accel_lsb.",
        "exit 1",
    ),
    (
        "sample_rate",
        "units",
        "Wrong sample rate",
        "turned angles (of increments: specific force) alike on all axes off by one factor, no power of two",
        "All axes of the {sensor} read {ratio:.4g} times what is right, alike to {spread:.2g}: the sample rate is more "
        "likely {rate:.5g} Hz than {stated:.5g} Hz; correct sample_rate_hz or the time stamps.",
        "warning",
    ),
    (
        "gyro_clipped",
        "units",
        "A gyro reaches the end of its range",
        "readings at the stated range, or rows of the same extreme reading",
        "{channel} is at the limit of its range ({limit:.4g} rad/s) in {count} samples from {time:.6g} s: "
        "{sequence} is "
        "void; turn more slowly.",
        "warning",
    ),
    (
        "accel_clipped",
        "units",
        "An accelerometer reaches the end of its range",
        "readings at the stated range, or rows of the same extreme reading",
        "{channel} is at the limit of its range ({limit:.4g} m/s²) in {count} samples from {time:.6g} s: {sequence} is "
        "void; avoid shocks, or choose a wider range.",
        "warning",
    ),
    # --- frames ------------------------------------------------------------------------------------------------------
    (
        "gyro_sign_convention",
        "frames",
        "All gyro axes read with the wrong sign",
        "turned angles and the motion of gravity against the gyros",
        "All three gyros read the turns with the wrong sign: the unit states rotations the other way round; map the "
        "gyro axes as {mapping}.",
        "exit 1",
    ),
    (
        "accel_sign_convention",
        "frames",
        "The accelerometers read gravity, not specific force",
        "which way each face points at rest",
        "All three accelerometers read the opposite sign (at rest they point down): the unit states gravity instead of "
        "specific force; map the accelerometer axes as {mapping}.",
        "exit 1",
    ),
    (
        "gyro_axis_flipped",
        "frames",
        "One gyro axis reads with the wrong sign",
        "turned angles by axis",
        "Gyro axis {axis} reads the turns with the wrong sign, which makes the triad left-handed: map the gyro axes as "
        "{mapping}.",
        "exit 1",
    ),
    (
        "accel_axis_flipped",
        "frames",
        "One accelerometer axis reads with the wrong sign",
        "which way each face points at rest",
        "Accelerometer axis {axis} reads with the wrong sign, which makes the triad left-handed: map the accelerometer "
        "axes as {mapping}.",
        "exit 1",
    ),
    (
        "gyro_axes_swapped",
        "frames",
        "Two gyro axes are swapped",
        "turned angles by axis",
        "Gyro axes {axes} are swapped: map the gyro axes as {mapping}.",
        "exit 1",
    ),
    (
        "accel_axes_swapped",
        "frames",
        "Two accelerometer axes are swapped",
        "which way each face points at rest",
        "Accelerometer axes {axes} are swapped: map the accelerometer axes as {mapping}.",
        "exit 1",
    ),
    (
        "left_handed",
        "frames",
        "Gyros and accelerometers share a left-handed frame",
        "turned angles and faces together",
        "Gyros and accelerometers agree, but in a left-handed frame: map the gyro axes as {gyro_mapping} and the "
        "accelerometer axes as {accel_mapping}.",
        "exit 1",
    ),
    (
        "frame_turned",
        "frames",
        "The unit's frame is turned by right angles",
        "turned angles and faces together",
        "Gyros and accelerometers agree with one another, but the unit's axes are not where the sequences have them: "
        "map the axes of both as {mapping}, or mount the unit as the table's axes say.",
        "exit 1",
    ),
    (
        "frames_disagree",
        "frames",
        "Gyro and accelerometer frames disagree",
        "motion of gravity in the accelerometers against the gyros",
        "The axes of gyros and accelerometers are not the same: map the gyro axes as {gyro_mapping} and the "
        "accelerometer axes as {accel_mapping}.",
        "exit 1",
    ),
    # --- sequences ---------------------------------------------------------------------------------------------------
    (
        "labels_shifted",
        "sequences",
        "The labelled windows lie beside the stillness",
        "labelled windows against the stillness found",
        "The labelled windows lie {shift:+.3g} s from where the unit stood still ({count} of {of} windows): "
        "correct the "
        "times of the labels, or leave them out to have the sequences recognised.",
        "exit 1",
    ),
    (
        "labels_exchanged",
        "sequences",
        "Sequences out of order: labels belong to other sequences",
        "turns and faces recognised against the labels",
        "What is labelled {labelled} was turned like {found}: the sequences were run out of order; correct the ids "
        "({count} of {of} differ), or leave the labels out.",
        "exit 1",
    ),
    (
        "wrong_direction",
        "sequences",
        "A sequence was turned the wrong way",
        "sign of each turn against its label or Table 1",
        "{title} was turned the other way ({found:+.4g}° in place of {expected:+.4g}°): repeat it, or correct "
        "its label.",
        "exit 1",
    ),
    (
        "wrong_angle",
        "sequences",
        "A sequence was turned by another angle",
        "angle of each turn against its label or Table 1, where gyros and accelerometers agree on it",
        "{title} was turned by {found:.5g}° where {expected:.4g}° is expected, more than the fixture's accuracy allows "
        "({count} such turns): the gyros measure what was turned, but check the fixture's stops.",
        "warning",
    ),
    (
        "sequence_missing",
        "sequences",
        "A sequence is missing",
        "sequences present against those that the closed form needs",
        "{missing} missing ({found} of 17 are there), so {parameters} cannot be found: record {them}.",
        "warning",
    ),
    (
        "sequence_repeated",
        "sequences",
        "A sequence was run more than once",
        "count of each sequence",
        "Run more than once: {sequences}; all runs are used.",
        "note",
    ),
    (
        "window_short",
        "sequences",
        "A stationary window is much shorter than the others",
        "lengths of the windows",
        "The window from {time:.6g} s lasts {duration:.3g} s, the others {typical:.3g} s in the median: stand still as "
        "long in all of them, as the shortest one limits {sequence}.",
        "warning",
    ),
    # --- windows -----------------------------------------------------------------------------------------------------
    (
        "unsettled",
        "windows",
        "The fixture had not settled",
        "oscillation at the start of windows that dies away",
        "The fixture still rings at the start of the window from {time:.6g} s ({sequence}; by {amplitude}, {count} "
        "such windows in all): wait longer after a turn, or start the windows later.",
        "warning",
    ),
    (
        "bump",
        "windows",
        "The unit was bumped in a window",
        "a step of attitude inside a window, on which gyros and accelerometers agree",
        "The unit was bumped at {time:.6g} s, in a stationary window of {sequence}: it turned by "
        "{angle_mrad:.3g} mrad; "
        "repeat the sequence.",
        "warning",
    ),
    (
        "creep",
        "windows",
        "The unit creeps in a window",
        "a steady tilt inside a window, on which gyros and accelerometers agree",
        "The unit creeps in the stationary window from {time:.6g} s ({sequence}): it tilts by "
        "{rate_urad_s:.3g} µrad/s; "
        "clamp it, and repeat the sequence.",
        "warning",
    ),
    (
        "noisy_window",
        "windows",
        "A window is noisier than the others",
        "noise of each window against that of the others",
        "The window from {time:.6g} s ({sequence}) is {ratio:.3g} times as noisy as the others ({sensor}): look for "
        "vibration, and repeat the sequence.",
        "warning",
    ),
    # --- motion ------------------------------------------------------------------------------------------------------
    (
        "sensor_time_offset",
        "motion",
        "Gyros and accelerometers are not sampled together",
        "the turning of gravity as the accelerometers see it against the gyros, by lag",
        "The accelerometers come {offset_ms:+.3g} ms after the gyros: align the time stamps of the two sensors.",
        "warning",
    ),
    (
        "samples_lost",
        "motion",
        "Samples were lost in a turn and the stamps do not tell",
        "a jump of specific force between two samples that the gyros do not explain",
        "In {sequence} about {duration:.2g} s are lost at {time:.6g} s though the stamps go on: gravity turned on by "
        "{angle_deg:.3g}° that the gyros do not show; repeat the sequence.",
        "warning",
    ),
    # --- site --------------------------------------------------------------------------------------------------------
    (
        "gravity",
        "site",
        "Gravity does not fit the latitude",
        "stated gravity against normal gravity at the stated latitude, from -500 m to 5000 m",
        "Gravity is stated as {stated:.6g} m/s², but at {latitude:.4g}° it lies between {low:.6g} and {high:.6g} m/s²: "
        "correct gravity_m_s2 or latitude_deg.",
        "warning",
    ),
    (
        "latitude",
        "site",
        "The Earth's rate does not fit the latitude",
        "vertical part and size of the horizontal part of the rate that is left at rest, over all attitudes",
        "The gyros see the Earth turn as at {found:.3g}° ± {sigma:.2g}° latitude, but {stated:.4g}° is stated: correct "
        "latitude_deg (north is positive).",
        "warning",
    ),
    (
        "north",
        "site",
        "The Earth's rate does not fit the heading",
        "direction of the horizontal part of the rate that is left at rest, over all attitudes",
        "The gyros see the table's x axis point {found:.4g}° ± {sigma:.2g}° from north, but {stated:.4g}° is stated: "
        "correct heading_deg (clockwise is positive).",
        "warning",
    ),
    # --- unit --------------------------------------------------------------------------------------------------------
    (
        "temperature_unit",
        "unit",
        "Temperature is not in °C",
        "range of the temperature column",
        "The temperature runs from {low:.4g} to {high:.4g}, which looks like {unit}, but °C is expected: convert the "
        "column.",
        "warning",
    ),
    (
        "temperature_drift",
        "unit",
        "The unit warmed up or cooled down during the test",
        "temperature by sequence",
        "The temperature went from {first:.4g} to {last:.4g} °C during the test (up to {range:.3g} °C apart): let the "
        "unit warm up first; the calibration holds for the mean of {mean:.4g} °C.",
        "warning",
    ),
    (
        "gyro_bias_drift",
        "unit",
        "The gyro bias drifts through the test",
        "rate left at rest by time, against its noise and the stated bias instability",
        "The bias of gyro {axis} went by {change_deg_h:+.3g} °/h through the test, more than its noise and stability "
        "allow: let the unit warm up, or state gyro_bias_instability_deg_per_h.",
        "warning",
    ),
    (
        "gyro_noise",
        "unit",
        "The gyros are noisier or quieter than stated",
        "noise of the windows against the one stated",
        "{who} {found:.3g} °/√h of angle random walk at rest, but {stated:.3g} is stated: correct "
        "gyro_noise_deg_per_sqrt_h, or look for vibration.",
        "warning",
    ),
    (
        "accel_noise",
        "unit",
        "The accelerometers are noisier or quieter than stated",
        "noise of the windows against the one stated",
        "{who} {found:.3g} µg/√Hz of noise at rest, but {stated:.3g} is stated: correct "
        "accel_noise_ug_per_sqrt_hz, or look for vibration.",
        "warning",
    ),
    (
        "asymmetry_omitted",
        "unit",
        "Scale-factor asymmetry was left out though the data show it",
        "turns in both senses against one another, by their noise",
        "Gyro {axis} has a scale-factor asymmetry of {found_ppm:.3g} ± {sigma_ppm:.2g} ppm, but it is held at "
        "{held_ppm:.3g}: leave out --no-asymmetry.",
        "warning",
    ),
)

FAULTS: Final = {row[0]: Fault(*row) for row in _ROWS}
"""All faults by name, causes before their consequences."""

RANK: Final = {name: rank for rank, name in enumerate(FAULTS)}
