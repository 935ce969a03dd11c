"""The pictures of the documentation are those that the present software draws, and the pages show them."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
import pictures
import pytest
from matplotlib.image import imread

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("name", pictures.PICTURES)
def test_pictures_are_those_of_the_present_software(name, tmp_path):
    if f"Matplotlib version{mpl.__version__}".encode() not in (pictures.FOLDER / name).read_bytes():
        pytest.skip("drawn by another version of matplotlib, whose letters differ")
    pictures.save_figure(pictures.PICTURES[name](), tmp_path / name)
    drawn, shown = imread(tmp_path / name), imread(pictures.FOLDER / name)
    assert drawn.shape == shown.shape, "run python benchmarks/pictures.py"
    differing = np.any(drawn != shown, axis=2)
    # Estimates that differ by rounding may move the edge of a mark by a pixel; a number that changed moves more.
    assert differing.mean() < 1e-4, "run python benchmarks/pictures.py"


@pytest.mark.parametrize("page", ["docs/index.md", "docs/tutorial.md", "docs/robustness.md", "README.md"])
def test_the_first_pages_show_the_pictures(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    shown = {"README.md": ["fixture.png", "convergence.png"], "docs/robustness.md": ["convergence.png"]}
    for name in shown.get(page, ["fixture.png", "calibration.png"]):
        assert f"images/{name})" in text
