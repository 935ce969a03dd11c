"""``srt convert``: what is written, what is said of it, and that a refusal leaves nothing behind."""

import tomllib

import numpy as np
import pytest
import recorded_sets

import srt
from srt.constants import DEG, STANDARD_GRAVITY_M_S2, normal_gravity_m_s2

N = 200
TIME = np.arange(1, N + 1) / 64.0
RNG = np.random.default_rng(8)
GYRO = RNG.normal(size=(N, 3))
ACCEL = RNG.normal(size=(N, 3)) * 0.1 + np.array([0.0, 0.0, 9.8])
HEADER = "time,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z"
SI = ["--gyro-unit", "rad/s", "--accel-unit", "m/s^2", "--time-unit", "s"]
SITE = ["--gravity-m-s2", "9.81"]


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "log.csv"
    np.savetxt(path, np.column_stack([TIME, GYRO, ACCEL]), header=HEADER, delimiter=",", comments="")
    return path


@pytest.fixture
def refused(refused):
    """Run a conversion to a folder that leaves nothing behind: its sentence."""

    def run(folder, *arguments, code=2):
        there = folder.exists()
        sentence = refused("convert", *arguments, "-o", folder, code=code, sentences=3)
        assert folder.exists() == there
        return sentence

    return run


@pytest.mark.parametrize("kind", ["csv", "npz", "parquet", "h5"])
def test_the_recording_holds_what_the_log_held(log, tmp_path, kind, shell):
    if kind in ("parquet", "h5"):
        pytest.importorskip({"parquet": "pyarrow", "h5": "h5py"}[kind])
    out, err = shell("convert", log, "-o", tmp_path / "new" / "rec", "--to", kind, *SI, *SITE)
    assert sorted(path.name for path in (tmp_path / "new" / "rec").iterdir()) == ["recording.toml", f"samples.{kind}"]
    loaded = srt.load_recording(tmp_path / "new" / "rec")
    # Written with 18 digits and read back: the same bits.
    np.testing.assert_array_equal(loaded.time, TIME)
    np.testing.assert_array_equal(loaded.gyro, GYRO)
    np.testing.assert_array_equal(loaded.accel, ACCEL)
    assert loaded.fixture is None
    assert "No fixture is stated, so that attitudes and heading are unknown (a free recording)." in " ".join(
        out.split()
    )
    assert err == ""
    for fragment in ("table as text (csv)", "200 (rate)", "64 Hz (stamps), 0 gaps", "3.1 s", "rad/s (as given)"):
        assert fragment in out
    assert f"median {np.median(np.linalg.norm(ACCEL, axis=1)):.5g} m/s²" in out
    assert f"Written to {tmp_path / 'new' / 'rec'}: recording.toml, samples.{kind}" in out


def test_all_that_may_be_said_is_written(log, tmp_path, shell):
    said = [
        *("--latitude-deg", "45.5", "--height-m", "100", "--heading-deg", "-30", "--alignment-sigma-mrad", "2"),
        *("--rotation-sigma-mrad", "0.5", "--serial", "SN-9", "--date", "2024-05-06", "--temperature-c", "21.5"),
        *("--sample-rate-hz", "64", "--map-gyro", "y,x,-z", "--map-accel", "y,x,-z"),
    ]
    out, _ = shell("convert", log, "-o", tmp_path / "rec", "-q", *SI, *said)
    assert out == ""
    written = tomllib.loads((tmp_path / "rec" / "recording.toml").read_text())
    assert written["fixture"] == {"heading_deg": -30.0, "alignment_sigma_mrad": 2.0, "rotation_sigma_mrad": 0.5}
    main_section = written["recording"]
    assert (main_section["serial"], main_section["date"]) == ("SN-9", "2024-05-06")
    assert (main_section["temperature_c"], main_section["sample_rate_hz"]) == (21.5, 64.0)
    loaded = srt.load_recording(tmp_path / "rec")
    assert loaded.site.gravity_m_s2 == normal_gravity_m_s2(45.5 * DEG, 100.0)
    assert loaded.site.gravity_sigma_m_s2 == 5e-4
    np.testing.assert_array_equal(loaded.accel, ACCEL[:, [1, 0, 2]] * [1, 1, -1])


def test_like_another_recording(log, tmp_path, shell):
    model = srt.Recording(
        TIME,
        GYRO,
        ACCEL,
        srt.Site(9.8, 1e-4, 0.5),
        fixture=srt.Fixture(0.25, 2e-3, 3e-3),
        noise=srt.ImuNoise(gyro_noise=1e-4),
        sequences=(srt.SequenceLabel((0.0, 1.0), (2.0, 3.0), id="1"),),
        serial="another unit",
    )
    srt.write_recording(model, tmp_path / "model")
    said = shell("convert", log, "-o", tmp_path / "a", "--like", tmp_path / "model", *SI).out
    said += shell("convert", log, "-o", tmp_path / "b", "--like", tmp_path / "model/recording.toml", *SI, *SITE).out
    first, second = (srt.load_recording(tmp_path / name) for name in "ab")
    assert "No fixture" not in said
    for loaded in (first, second):
        assert loaded.fixture == model.fixture
        assert loaded.noise == model.noise
        assert loaded.sequences == model.sequences
        assert loaded.serial is None
        assert loaded.site.latitude_rad == pytest.approx(0.5, rel=1e-15)  # through degrees and back
    assert (first.site.gravity_m_s2, first.site.gravity_sigma_m_s2) == (9.8, 1e-4)
    # Gravity that is said has its own uncertainty.
    assert (second.site.gravity_m_s2, second.site.gravity_sigma_m_s2) == (9.81, pytest.approx(0.01 / 12**0.5))


@pytest.mark.parametrize(
    ("typed", "sigma"),
    [("9.81", 0.01 / 12**0.5), ("9.8100", 1e-4 / 12**0.5), ("9.80620", 5e-6), ("10", 1 / 12**0.5), ("9.80665", 0.02)],
)
def test_a_gravity_without_a_sigma_has_that_of_its_digits(log, tmp_path, shell, typed, sigma):
    said = shell("convert", log, "-o", tmp_path / "rec", "-q", *SI, "--gravity-m-s2", typed, "--force").err
    site = srt.load_recording(tmp_path / "rec").site
    assert site.gravity_m_s2 == float(typed)
    assert (site.gravity_sigma_m_s2, site.gravity_sigma_origin) == (pytest.approx(sigma), "assumed")
    assert ("the standard value, which is that of no place" in said) == (typed == "9.80665")
    assert not said or "its sigma is taken as 0.02 m/s², 2039 ppm" in said
    # Options that are given are not asked for.
    given = ("--gravity-m-s2", typed, "--latitude-deg", "45", "--force", "--overwrite")
    again = shell("convert", log, "-o", tmp_path / "rec", "-q", *SI, *given).err
    assert ("In its place, give --height-m, or the gravity of the site" in again) == (typed == "9.80665")
    # A sigma that is stated is no assumption any more.
    stated = srt.read(tmp_path / "rec", gravity_sigma_m_s2=1e-5).site
    assert (stated.gravity_sigma_m_s2, stated.gravity_sigma_origin) == (1e-5, None)


def test_a_stated_sigma_of_gravity_stays(log, tmp_path, shell):
    given = ["--gravity-m-s2", "9.80665", "--gravity-sigma-m-s2", "1e-5"]
    assert not shell("convert", log, "-o", tmp_path / "rec", "-q", *SI, *given, "--force").err
    assert srt.load_recording(tmp_path / "rec").site == srt.Site(9.80665, 1e-5)


def test_units_in_the_spellings_of_files(log, tmp_path, refused, shell):
    units = ["--gyro-unit", "rad s^-1", "--accel-unit", "m/s²", "--time-unit", "sec"]
    shell("convert", log, "-o", tmp_path / "rec", "-q", *units, *SITE)
    np.testing.assert_array_equal(srt.load_recording(tmp_path / "rec").accel, ACCEL)
    message = refused(tmp_path / "bad", log, *SITE, "--accel-unit", "ft/s^2")
    assert "'ft/s^2' is not one of 'm/s^2', 'g', 'mg', 'm/s', 'g*s', 'counts'" in message


@pytest.mark.parametrize(
    ("arguments", "fragments"),
    [
        (SI, ["Gravity is not known", "--gravity-m-s2", "--like"]),
        ([*SI, "--latitude-deg", "45"], ["Gravity is not known", "--height-m"]),
        ([*SI, "--gravity-m-s2", "-9.81"], ["gravity_m_s2 is -9.81", "9.5 to 10.1"]),
        ([*SI, *SITE, "--latitude-deg", "95"], ["latitude_deg is 95", "-90 to 90"]),
        ([*SI, *SITE, "--alignment-sigma-mrad", "0"], ["alignment_sigma_mrad is 0"]),
        ([*SITE], ["log.csv", "the unit of gyro, accel", "--gyro-unit", "--accel-unit", "--gyro-lsb alone"]),
        ([], ["log.csv", "the unit of gyro, accel", "--gyro-unit", "--accel-unit", "Gravity is not known"]),
        ([*SI, *SITE, "--format", "euroq"], ["no format 'euroq' (did you mean euroc?)"]),
        ([*SI, *SITE, "--topic", "/imu"], ["--topic is given, but the format csv"]),
        ([*SI, *SITE, "--gyro-unit", "counts"], ["--gyro-lsb"]),
        (
            ["--gyro-unit", "counts", "--accel-unit", "counts"],
            [
                "the unit of time",
                "The gyro and accel readings are counts",
                "--gyro-lsb",
                "--accel-lsb",
                "Gravity is not",
            ],
        ),
        ([*SI, *SITE, "--map-gyro", "x,y"], ["--map-gyro is 'x,y'"]),
        ([*SI, *SITE, "--columns", "time=tme"], ["no column tme (did you mean time?)"]),
        ([*SI, *SITE, "--sample-rate-hz", "100"], ["log.csv", "sample_rate_hz is 100"]),
        ([*SI, *SITE, "--like", "nowhere"], ["no recording nowhere"]),
    ],
)
def test_refusals(log, tmp_path, refused, arguments, fragments):
    message = refused(tmp_path / "rec", log, *arguments)
    assert all(fragment in message for fragment in fragments), message


@pytest.mark.parametrize(
    ("arguments", "fragment"),
    [
        (["--accel-unit", "g"], "look like m/s², declared as g"),
        (["--accel-unit", "m/s", "--gyro-unit", "rad", "--kind", "increment"], "accelerometers read"),
    ],
)
def test_a_wrong_unit_shows_in_gravity(log, tmp_path, refused, arguments, fragment, shell):
    message = refused(tmp_path / "rec", log, *SI, *SITE, *arguments, code=1)
    assert str(log) in message
    assert fragment in message
    shell("convert", log, "-o", tmp_path / "rec", *SI, *SITE, *arguments, "--force")
    factor = STANDARD_GRAVITY_M_S2 if "g" in arguments else 1.0
    np.testing.assert_array_equal(srt.load_recording(tmp_path / "rec").accel, ACCEL * factor)


def test_a_wrong_value_of_a_count_is_named(log, tmp_path, refused):
    units = ["--gyro-unit", "rad/s", "--time-unit", "s", "--accel-lsb", "0.1"]
    message = refused(tmp_path / "rec", log, *units, *SITE, code=1)
    assert "With the stated value of a count, 0.1, the accelerometers read 0.0997 times gravity" in message
    assert "correct --accel-lsb, or add --force" in message


@pytest.mark.parametrize(
    ("time", "rate", "said"),
    [
        (1e3, 1.0, "a rate of 0.064 Hz, which no IMU has: check --time-unit"),
        (1.0, 1.0 / DEG, "more than any IMU measures: check --gyro-unit"),
    ],
)
def test_units_that_nothing_rules_out_are_told(log, tmp_path, time, rate, said, shell):
    """Said, not refused."""
    np.savetxt(log, np.column_stack([time * TIME, rate * GYRO, ACCEL]), header=HEADER, delimiter=",", comments="")
    out, _ = shell("convert", log, "-o", tmp_path / "rec", *SI, *SITE)
    assert said in " ".join(out.split())


def test_counts_are_told_with_their_value_and_zero(log, tmp_path, shell):
    """Readings of 0.25 °/s and 1 mm/s² a count, with offsets, after a gap of 2 s; then the same in rad/s by mistake."""
    counts = np.column_stack([np.round(GYRO / (0.25 * DEG)) + 12, np.round(ACCEL / 1e-3) - 30])
    time = TIME + np.where(np.arange(TIME.size) < TIME.size // 2, 0.0, 2.0)
    np.savetxt(log, np.column_stack([time, counts]), header=HEADER, delimiter=",", comments="")
    given = ["--time-unit", "s", "--gyro-offset", "12", "--accel-lsb", "1e-3", "--accel-offset", "-30", *SITE]
    out, _ = shell("convert", log, "-o", tmp_path / "rec", "--gyro-lsb", "1/4 deg/s", *given)
    out = " ".join(out.split())
    assert "counts (as given) of 0.00436332 rad/s (0.25 °/s), zero at 12" in out
    assert "counts (as given) of 0.001 m/s², zero at -30" in out
    assert "s of samples, 2.0 s of gaps" in out
    assert "Note: The gyros" not in out
    gyro = srt.load_recording(tmp_path / "rec").gyro
    np.testing.assert_allclose(gyro, GYRO, atol=0.125 * DEG * (1.0 + 1e-9))  # rounding to a count
    out, _ = shell("convert", log, "-o", tmp_path / "other", "--gyro-lsb", "250", *given)
    assert "more than any IMU measures: check --gyro-lsb" in " ".join(out.split())


def test_places(log, tmp_path, refused, shell):
    arguments = [*SI, *SITE]
    shell("convert", log, "-o", tmp_path / "rec", *arguments)
    assert "holds files already" in refused(tmp_path / "rec", log, *arguments)
    shell("convert", log, "-o", tmp_path / "rec", *arguments, "--overwrite", "--to", "npz")
    assert "is a file" in refused(log, log, *arguments)
    samples = tmp_path / "rec" / "samples.csv"
    message = refused(tmp_path / "rec", samples, *arguments, "--overwrite")
    assert "replaced by its own conversion" in message
    assert "is a recording already" in refused(tmp_path / "other", tmp_path / "rec", *arguments)
    assert "There is no file" in refused(tmp_path / "other", tmp_path / "absent.bag", *arguments)
    assert "is no recording" in refused(tmp_path / "other", log, *arguments, "--like", log)


def test_formats_are_listed(shell):
    from srt.recording.importer_registry import IMPORTERS

    out, _ = shell("convert", "--list")
    assert all(f"\n {name} " in out for name in IMPORTERS)


# The recorded sets, by the commands that a user would give.

FOLDER = recorded_sets.data_folder()
needs_sets = pytest.mark.skipif(
    FOLDER is None, reason=f"recorded sets not found; set {recorded_sets.DATA_VARIABLE} to their folder"
)


def assert_same(loaded, expected, rtol=0.0):
    np.testing.assert_array_equal(loaded.time, expected.time)
    np.testing.assert_allclose(loaded.gyro, expected.gyro, rtol=rtol, atol=0.0)
    np.testing.assert_allclose(loaded.accel, expected.accel, rtol=rtol, atol=0.0)
    assert loaded.site == expected.site
    assert loaded.sample_rate_hz == expected.sample_rate_hz


@needs_sets
def test_xsens_set(tmp_path, shell):
    folder = FOLDER / "xsens_mti"
    arguments = [
        *(folder / "xsens_acc.mat", folder / "xsens_gyro.mat", "-o", tmp_path / "rec", "--to", "npz", "-q"),
        *("--time-unit", "s", "--gyro-lsb", "1/4770", "--gyro-offset", "32768"),
        *("--accel-lsb", "1/415", "--accel-offset", "33000"),
        *("--gravity-m-s2", "9.81744", "--gravity-sigma-m-s2", "5e-4", "--latitude-deg", "45.4"),
    ]
    shell("convert", *arguments)
    # A product with a rounded 1/x differs from the quotient by the roundings of both, half an ulp each.
    assert_same(srt.load_recording(tmp_path / "rec"), recorded_sets.xsens_mti(FOLDER), rtol=2.0 * np.finfo(float).eps)


@needs_sets
@pytest.mark.parametrize("unit", [0, 1])
def test_mpu9150_set(tmp_path, unit, shell):
    arguments = [
        *(FOLDER / "mpu9150" / f"imu{unit}.log", "-o", tmp_path / "rec", "--columns", "accel,gyro", "-q"),
        *("--gyro-unit", "rad/s", "--accel-unit", "m/s^2", "--sample-rate-hz", "100"),
        *("--gravity-m-s2", "9.81", "--gravity-sigma-m-s2", "5e-3"),
    ]
    shell("convert", *arguments)
    expected = recorded_sets.mpu9150(FOLDER, unit)
    loaded = srt.load_recording(tmp_path / "rec")
    # k/100 and k times 0.01 differ by the roundings of both, half an ulp each and one of 0.01.
    np.testing.assert_allclose(loaded.time, expected.time, rtol=2.0 * np.finfo(float).eps)
    np.testing.assert_array_equal(loaded.gyro, expected.gyro)
    np.testing.assert_array_equal(loaded.accel, expected.accel)
    assert (loaded.site, loaded.sample_rate_hz) == (expected.site, expected.sample_rate_hz)


@needs_sets
def test_ferraris_set(tmp_path, shell):
    arguments = [
        *(FOLDER / "ferraris" / "example_ferraris_session.csv", "-o", tmp_path / "rec", "-q"),
        *("--gyro-unit", "deg/s", "--accel-unit", "m/s^2", "--sample-rate-hz", "102.4"),
        *("--gravity-m-s2", "9.81", "--gravity-sigma-m-s2", "5e-3"),
    ]
    shell("convert", *arguments)
    assert_same(srt.load_recording(tmp_path / "rec"), recorded_sets.ferraris(FOLDER))


def written(path, head, *columns, form="%.18g"):
    np.savetxt(path, np.column_stack(columns), header=head, delimiter=",", comments="", fmt=form)
    return path


def test_a_column_of_time_with_another_name_is_named_in_the_option(tmp_path, shell, refused):
    log = written(tmp_path / "log.csv", HEADER.replace("time", "Zeit"), TIME, GYRO, ACCEL)
    sentence = refused(tmp_path / "new", log, *SI[:4], *SITE)
    assert "give the rate with --sample-rate-hz" in sentence
    assert "or name the column of time, as --columns 'time=Zeit' (columns not read: Zeit)." in sentence
    shell("convert", log, "-o", tmp_path / "new", "--columns", "time=Zeit", *SI, *SITE)
    np.testing.assert_array_equal(srt.load_recording(tmp_path / "new").time, TIME)


@pytest.mark.parametrize("kind", ["csv", "npz", "pair"])
def test_a_stated_rate_replaces_stamps_without_a_unit(tmp_path, kind, shell):
    log = [written(tmp_path / "log.csv", HEADER.replace("time", "Zeit"), TIME, GYRO, ACCEL)]
    if kind == "npz":
        log = [tmp_path / "log.npz"]
        np.savez(log[0], Zeit=TIME, gyro=GYRO, accel=ACCEL)
    columns = ["--columns", "time=Zeit"]
    if kind == "pair":
        log = [written(tmp_path / f"{name}.csv", "t,x,y,z", TIME, x) for name, x in (("acc", ACCEL), ("gyr", GYRO))]
        columns = []
    out = shell("convert", *log, "-o", tmp_path / "new", *columns, *SI[:4], *SITE, "--sample-rate-hz", 50).out
    assert "not used: their unit is not stated, and --sample-rate-hz is." in " ".join(out.split())
    found = srt.load_recording(tmp_path / "new")
    np.testing.assert_allclose(found.time, np.arange(1, N + 1) / 50.0, rtol=1e-15)
    np.testing.assert_array_equal(found.gyro, GYRO)


@pytest.mark.parametrize("kind", ["csv", "npz"])
def test_a_counter_of_32_bits_is_counted_on(tmp_path, kind, shell, refused):
    """Stamps in disorder are refused: they do not jump by the whole counter."""
    ticks = np.arange(N) * 15625 + 2**32 - 10**6
    log = written(tmp_path / "log.csv", HEADER, ticks % 2**32, GYRO, ACCEL)
    if kind == "npz":
        log = tmp_path / "log.npz"
        np.savez(log, time=(ticks % 2**32).astype(np.uint32), gyro=GYRO, accel=ACCEL)
    units = [*SI[:4], "--time-unit", "us", *SITE]
    out = shell("convert", log, "-o", tmp_path / "new", *units).out
    assert "The 32-bit counter of the time stamps overflowed once, and is counted on." in " ".join(out.split())
    np.testing.assert_allclose(np.diff(srt.load_recording(tmp_path / "new").time), 1.0 / 64.0, rtol=1e-9)
    restarted = np.where(np.arange(N) < 100, ticks - 2**31, (ticks - ticks[100]))
    other = written(tmp_path / "other.csv", HEADER, restarted, GYRO, ACCEL)
    assert "goes back" in refused(tmp_path / "none", other, *units)


def test_a_folder_and_a_file_named_twice_are_called_so(log, tmp_path, unit, refused, shell):
    (tmp_path / "logs").mkdir()
    assert "logs is a folder" in refused(tmp_path / "new", tmp_path / "logs", *SI, *SITE)
    assert "log.csv is named twice" in refused(tmp_path / "new", log, log, *SI, *SITE)
    for words in (("certificate", tmp_path / "logs"), ("certificate", unit, "--limits", tmp_path / "logs")):
        assert "it is a folder, and a file is expected" in shell(*words, code=2).err


def test_a_column_that_the_log_lacks_is_not_read_from_another(tmp_path, refused):
    log = written(tmp_path / "log.csv", "time,gx,gy,gz,ax,ay", TIME, GYRO, ACCEL[:, :2])
    sentence = refused(tmp_path / "rec", log, *SI, *SITE)
    assert "no column was recognised as accel_z, and the file lacks it: all columns are read as others" in sentence
    sentence = refused(tmp_path / "rec", log, *SI, *SITE, "--columns", "accel_z=ay")
    assert "column 6 would be read as accel_z and as accel_y" in sentence


def test_swapped_axes_are_corrected_by_the_option_that_is_named(recording, tmp_path, shell):
    loaded = srt.read(recording)
    accel = loaded.accel[:, [1, 0, 2]]
    log = written(tmp_path / "log.csv", HEADER, loaded.time, loaded.gyro, accel)
    given = [*SI, "--gravity-m-s2", loaded.site.gravity_m_s2, "--latitude-deg", 45, "--heading-deg", 0]
    shell("convert", log, "-o", tmp_path / "swapped", *given)
    sentence = shell("inspect", tmp_path / "swapped", "-q", code=1).err
    assert "convert the log again with --map-accel y,x,z." in sentence
    option = sentence.rpartition(" with ")[2].rstrip(".\n").split()
    shell("convert", log, "-o", tmp_path / "right", *given, *option)
    assert "No fault found." in shell("inspect", tmp_path / "right").out
    assert "exchange the names of the two columns in its samples file; otherwise" in sentence
    samples = tmp_path / "swapped" / "samples.csv"
    head, _, rest = samples.read_text().partition("\n")
    samples.write_text(head.replace("accel_x,accel_y", "accel_y,accel_x") + "\n" + rest)
    assert "No fault found." in shell("inspect", tmp_path / "swapped").out
