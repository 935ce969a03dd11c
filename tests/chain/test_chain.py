"""Every recording through every estimator to every output, with the values checked.

The default form has every pair of recording, estimator and output; ``-m slow`` has the rest of the product, with the
figures of certificates and the files of figures.
"""

import hashlib
import pickle
from functools import cache
from itertools import combinations
from pathlib import Path

import pytest
from chain_outputs import CHEAP, OUTPUTS, PRODUCT, Chain, covering

for package in ("filterpy", "gtsam", "matplotlib", "pandas", "fpdf", "jinja2"):
    pytest.importorskip(package)

pytestmark = pytest.mark.usefixtures("plain_layout")


@pytest.fixture(scope="session")
def chains(tmp_path_factory):
    """Give the chain of a recording, made once in a process: the tests are in the order of the recordings."""
    return cache(lambda name: Chain(name, tmp_path_factory.mktemp(name)))


def by_content(content, function):
    """Function whose results are kept by the content of its arguments."""
    made = {}

    def once(*arguments, **options):
        key = hashlib.sha256(pickle.dumps(content(*arguments, **options))).digest()
        if key not in made:
            made[key] = function(*arguments, **options)
        return made[key]

    return once


@pytest.fixture(scope="module", autouse=True)
def each_result_once():
    """Commands that calibrate the same recording with the same options, or load the same file, do so once."""
    from srt.comparison import estimator_comparison
    from srt.estimation import registry
    from srt.result import calibration

    find, load = registry.find_estimator, calibration.load_calibration
    known = cache(lambda name: by_content(lambda recording, options, progress=None: (recording, options), find(name)))
    with pytest.MonkeyPatch.context() as patch:
        for module in (registry, estimator_comparison):
            patch.setattr(module, "find_estimator", known)
        patch.setattr(
            calibration,
            "load_calibration",
            by_content(lambda path, **options: (Path(path).read_bytes(), options), load),
        )
        yield


def marks(member):
    """Marks of a member of the product."""
    return [] if member in covering() else [pytest.mark.slow]


@pytest.mark.parametrize(
    ("name", "estimator", "output"), [pytest.param(*each, id="-".join(each), marks=marks(each)) for each in PRODUCT]
)
def test_chain(request, chains, monkeypatch, name, estimator, output):
    chain = chains(name)
    chain.pictures = request.node.get_closest_marker("slow") is not None
    if not chain.pictures:
        for module in ("html_page", "pdf"):
            monkeypatch.setattr(f"srt.reports.certificate.{module}.certificate_figures", lambda certificate: ())
    (CHEAP | OUTPUTS)[output](chain, estimator)


def test_every_pair_occurs():
    for first, second in combinations(range(3), 2):
        wanted = {(each[first], each[second]) for each in PRODUCT}
        assert {(each[first], each[second]) for each in covering()} == wanted
