"""Every recording through every estimator to every output, with the values checked.

The default form has every pair of recording, estimator and output; ``-m slow`` has a twentieth of the rest of the
product, and ``-m campaign`` all else, with the figures of certificates and the files of figures.
"""

import hashlib
import pickle
from functools import cache
from itertools import combinations
from pathlib import Path

import pytest
from chain_outputs import CHEAP, OUTPUTS, PRODUCT, Chain, covering, twentieth

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
    if member in covering():
        return []
    return [pytest.mark.slow if member in twentieth() else pytest.mark.campaign]


@pytest.mark.parametrize(
    ("name", "estimator", "output"), [pytest.param(*each, id="-".join(each), marks=marks(each)) for each in PRODUCT]
)
def test_chain(request, chains, monkeypatch, name, estimator, output):
    chain = chains(name)
    chain.pictures = (name, estimator, output) not in covering()
    if not chain.pictures:
        for module in ("html_page", "pdf"):
            monkeypatch.setattr(f"srt.reports.certificate.{module}.certificate_figures", lambda certificate: ())
    (CHEAP | OUTPUTS)[output](chain, estimator)


def test_every_pair_occurs():
    for first, second in combinations(range(3), 2):
        wanted = {(each[first], each[second]) for each in PRODUCT}
        assert {(each[first], each[second]) for each in covering()} == wanted


def test_the_slow_tests_are_a_twentieth_of_the_rest_with_every_estimator_output_and_recording_that_it_has():
    rest = set(PRODUCT) - covering()
    assert twentieth() <= rest
    assert 0.9 * len(rest) < 20 * len(twentieth()) < 1.1 * len(rest)
    for part in range(3):
        assert {each[part] for each in twentieth()} == {each[part] for each in rest}
