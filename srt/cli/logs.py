"""Logs as arguments of 'srt calibrate': conversion to a recording, questions for what is missing, second runs."""

from __future__ import annotations

import shlex
import sys
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click
from click.core import ParameterSource

from srt.cli.convert import GROUPS, read_source
from srt.cli.convert import convert as convert_command
from srt.cli.grouped_command import ARGUMENTS
from srt.cli.messages import progress_line, show
from srt.cli.output_paths import check_recording_target, make_directory
from srt.cli.overwriting import is_unchanged
from srt.exceptions import InputError, NotStatedError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from srt.recording.recording import Recording

_PARAMETERS: Final = {each.name: each for each in convert_command.params if isinstance(each, click.Option)}
_NAMES: Final = ("like", *(name for names in GROUPS.values() for name in names))
"""Names of the options that describe a log."""
_READING: Final = frozenset(next(iter(GROUPS.values())))
"""Those that the samples were read by."""
_RECORDING: Final = "recording"
_CONVERSION: Final = "conversion.json"
"""Recording that was made of a log, and the file beside it with the digests of both and the options."""
_FORMAT: Final = "srt-conversion"
_VERSION: Final = 1
_QUESTIONS: Final = {
    "gyro_unit": "Unit of the gyros",
    "accel_unit": "Unit of the accelerometers",
    "time_unit": "Unit of the time stamps",
    "gyro_lsb": "Value of one count of the gyros, as 1/131 deg/s",
    "accel_lsb": "Value of one count of the accelerometers, as 1/16384 g",
    "sample_rate_hz": "Sample rate, Hz",
    "latitude_deg": "Latitude of the site, degrees",
    "height_m": "Height of the site above sea level, m",
}
"""Question at a terminal for an option that is missing."""


@dataclass(frozen=True, slots=True)
class Log:
    """Log to calibrate.

    Attributes
    ----------
    given : mapping of str to object
        Options of 'srt convert' that describe it.
    """

    path: Path
    given: Mapping[str, Any]

    def read(self, *, force: bool, quiet: bool) -> Recording:
        """Read the log; what it does not state is asked for at a terminal. Raises SrtError."""
        return self._read(self.given, force=force, quiet=quiet)[0]

    def convert(self, folder: Path, *, force: bool, quiet: bool) -> Recording:
        """Recording that an earlier run made of this log in a folder; the first run makes it.

        Options of the first run hold until they are given again. The recording is then made again, unless its
        ``recording.toml`` was edited.

        Raises
        ------
        SrtError
            A log that cannot be read or converted, a folder with the recording of another log, or options that
            would replace an edited ``recording.toml``.
        """
        from srt.recording.folder import TOML_NAME, load_recording, sha256_of
        from srt.recording.writing import write_recording
        from srt.result.json_file import save_json_file

        place = folder / _RECORDING
        digest = sha256_of(self.path)
        given, before = self.given, None
        if (place / TOML_NAME).is_file():
            before = self._earlier(folder, digest)
            given = {**before["options"], **_plain(self.given)}
            if given == before["options"]:
                if not quiet:
                    show(f"{place}, which was made of {self.path} before, is read as it is now\n")
                return load_recording(place)
            if not is_unchanged(place / TOML_NAME):
                changed = [name for name in self.given if given[name] != before["options"].get(name)]
                remedy = "enter the value there and leave the option out, or name another folder"
                if not set(changed).isdisjoint(_READING):
                    remedy = "name another folder, and repeat the edit there; these samples are in SI units already"
                raise InputError(
                    f"{place / TOML_NAME} was edited, and {', '.join(map(_flag, changed))} would replace it: {remedy}."
                )
        check_recording_target(place, overwrite=before is not None)
        recording, given = self._read(given, force=force, quiet=quiet)
        make_directory(folder)
        write_recording(recording, place, samples_format="npz", overwrite=True)
        about = {
            "format": _FORMAT,
            "version": _VERSION,
            "log": str(self.path),
            "log_sha256": digest,
            "options": _plain(given),
        }
        save_json_file(folder / _CONVERSION, about)
        if not quiet:
            show(f"Written to {place}: recording.toml, samples.npz\n")
        return load_recording(place)

    def _earlier(self, folder: Path, digest: str) -> dict[str, Any]:
        """Content of the file beside the recording. Raises InputError where that was not made of this log."""
        from srt.result.json_file import load_json_file, require_format

        def checked(document: dict[str, Any]) -> dict[str, Any]:
            require_format(document, "conversion", _FORMAT, _VERSION)
            return document

        file = folder / _CONVERSION
        with suppress(InputError):  # absent, damaged or edited
            document = load_json_file(file, "conversion", checked, signed=True)
            if document["log_sha256"] == digest:
                return document
        raise InputError(
            f"{folder / _RECORDING} was not made of {self.path}, by the digest in {file.name}: name another folder."
        )

    def _read(self, given: Mapping[str, Any], *, force: bool, quiet: bool) -> tuple[Recording, dict[str, Any]]:
        known = dict(given)
        while True:
            try:
                recording, text = read_source(self.path, None, known, force=force)
            except NotStatedError as error:
                known |= _answers(self.path, error)
            else:
                if not quiet:
                    show(text)
                return recording, known


def take_log(paths: Sequence[Path], choices: dict[str, Any]) -> Log | None:
    """Log among the arguments; its options are taken out of those of the command.

    Raises
    ------
    InputError
        A log beside other recordings, or options of a log without one.
    """
    context = click.get_current_context()
    given = {name: choices.pop(name) for name in _NAMES}
    given = {
        name: value
        for name, value in given.items()
        if context.get_parameter_source(name) is not ParameterSource.DEFAULT
    }
    logs = [path for path in paths if _is_log(path)]
    if not logs:
        if given:
            raise InputError(
                f"{_flag(next(iter(given)))} describes a log, and {paths[0]} is none: leave it out, or correct "
                "recording.toml."
            )
        return None
    if len(paths) > 1:
        raise InputError(f"{logs[0]} is a log, and a log is calibrated alone: convert it first (srt convert).")
    return Log(logs[0], given)


def _is_log(path: Path) -> bool:
    """True for a file, or a folder of a foreign format, that is no recording and no result."""
    if not path.is_dir():
        return path.is_file() and path.suffix not in (".toml", ".json")
    from srt.recording.folder import TOML_NAME
    from srt.recording.importer_registry import is_foreign

    return not (path / TOML_NAME).exists() and is_foreign(path)


def _answers(path: Path, error: NotStatedError) -> dict[str, Any]:
    """Values of what is missing, asked for at a terminal. Raises InputError, with the command, elsewhere."""
    context = click.get_current_context()
    if not all(stream is not None and stream.isatty() for stream in (sys.stdin, sys.stderr)):
        missing = [word for name in error.missing for word in (_flag(name), name.upper())]
        command = shlex.join([*context.command_path.split(), *context.meta[ARGUMENTS], *missing])
        raise InputError(f"{error} The command with all of it: {command}.")
    progress_line(f"{path} does not state all that a calibration needs ({_flag(error.missing[0])} and so on state it).")
    return {name: click.prompt(_QUESTIONS[name], type=_PARAMETERS[name].type, err=True) for name in error.missing}


def _flag(name: str) -> str:
    """Option as messages name it."""
    return max(_PARAMETERS[name].opts, key=len)


def _plain(given: Mapping[str, Any]) -> dict[str, Any]:
    """Options as JSON holds them."""
    return {name: str(value) if isinstance(value, Path) else value for name, value in given.items()}
