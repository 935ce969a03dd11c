"""Every recording through every estimator to every output, with the values checked.

The default form has every pair of recording, estimator and output; ``-m slow`` has the rest of the product, with the
figures of certificates and the files of figures.
"""

from functools import cache
from itertools import combinations

import pytest
from chain_outputs import CHEAP, OUTPUTS, PRODUCT, Chain, covering

for package in ("filterpy", "gtsam", "matplotlib", "pandas", "fpdf", "jinja2"):
    pytest.importorskip(package)

pytestmark = pytest.mark.usefixtures("plain_layout")


@pytest.fixture(scope="session")
def chains(tmp_path_factory):
    """Give the chain of a recording, made once in a process: the tests are in the order of the recordings."""
    return cache(lambda name: Chain(name, tmp_path_factory.mktemp(name)))


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
