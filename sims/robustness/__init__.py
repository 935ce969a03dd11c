"""Robustness campaigns: convergence and accuracy of the estimators against the size of the initial sensor errors."""

from importlib.util import find_spec

from srt.exceptions import MissingExtraError

for _library in ("filelock", "pandas", "pyarrow", "pydantic"):
    if find_spec(_library) is None:
        raise MissingExtraError(_library, "campaign", "A robustness campaign")
