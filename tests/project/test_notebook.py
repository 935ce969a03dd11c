"""The notebook runs from its first cell to its last, and the calibration shortens the drift."""

import os
import re
import shutil
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def test_notebook_runs(tmp_path, monkeypatch):
    nbclient, nbformat = pytest.importorskip("nbclient"), pytest.importorskip("nbformat")
    pytest.importorskip("ipykernel")
    pytest.importorskip("pyins")
    for file in (ROOT / "examples").glob("*.py"):
        shutil.copy(file, tmp_path)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), str(tmp_path)]))
    for folder in ("IPYTHONDIR", "JUPYTER_DATA_DIR", "JUPYTER_RUNTIME_DIR"):
        monkeypatch.setenv(folder, str(tmp_path / folder.lower()))
    notebook = nbformat.read(ROOT / "examples" / "from_log_to_navigation.ipynb", as_version=4)
    assert not any(cell.get("outputs") for cell in notebook.cells), "clear the outputs before committing"
    nbclient.NotebookClient(
        notebook, timeout=300, kernel_name="python3", resources={"metadata": {"path": str(tmp_path)}}
    ).execute()
    outputs = [out for cell in notebook.cells for out in cell.get("outputs", ())]
    text = "".join(out.get("text", "") for out in outputs)
    logged, corrected = (float(found) for found in re.findall(r": (\d+) m from the true position", text))
    assert corrected < 0.5 * logged
    rms = float(re.search(r"rms of error over sigma: ([\d.]+)", text)[1])
    assert 0.5 < rms < 1.55  # chi-square of 27 degrees of freedom with correlated errors: as in the demo's test
    pages = [out["data"].get("text/html", "") for out in outputs if "data" in out]
    assert any("gyro_scale_x" in page for page in pages)
