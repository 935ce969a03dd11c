"""The errors that a person can act on: one sentence each, with the exit code the command line gives it."""


class SrtError(Exception):
    """Base of all errors of this package; the message is one sentence for the person who reads it.

    Attributes
    ----------
    exit_code : int
        What the command line exits with: 1, the data cannot support a result; 2, wrong usage or unreadable input.
    fault : str or None
        Its name in the catalogue of faults (:mod:`srt.diagnosis.faults`), if it stands there.
    """

    exit_code = 2

    def __init__(self, *args: object, fault: str | None = None) -> None:
        super().__init__(*args)
        self.fault = fault


class InputError(SrtError):
    """Unreadable input or wrong usage (exit code 2)."""

    exit_code = 2


class DataError(SrtError):
    """Readable data that cannot support the result asked for (exit code 1)."""

    exit_code = 1


class MissingExtraError(InputError):
    """An optional dependency is absent; the message says what to install."""

    def __init__(self, package: str, extra: str, purpose: str) -> None:
        super().__init__(
            f"{purpose} needs the package {package!r}, which is not installed: "
            f"run pip install 'strapdown-rotation-test[{extra}]'."
        )
