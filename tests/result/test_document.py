"""Dataclasses as JSON documents: what is written, and what is refused when it is read."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

import srt
from srt.result.document import from_document, to_document
from srt.types import Array


@dataclass(frozen=True, kw_only=True)
class Row:
    with_: str
    size: float | None


@dataclass(frozen=True, eq=False, kw_only=True)
class Table:
    count: int
    rows: tuple[Row, ...] = ()
    pair: tuple[float, int] | None = None
    by_name: Mapping[str, Row] | None = None
    values: Array | None = None
    origin: str | Mapping[str, str] | None = None
    sure: bool | None = None
    nulls: tuple[str, ...] = ()
    further: Mapping[str, Any] = field(default_factory=dict)


WHOLE = {
    "count": 2,
    "rows": [{"with": "a", "size": 1.5}, {"with": "b", "size": None}],
    "pair": [1, 2],
    "by_name": {"x": {"with": "c", "size": 2}},
    "values": [[1.0, 2.0]],
    "origin": {"srt": "0.1"},
    "sure": None,
    "other": {"any": [1, None]},
}


def test_a_document_is_read_and_written_without_loss():
    table = from_document(Table, WHOLE, "table")
    assert to_document(table) == WHOLE
    assert list(to_document(table)) == list(WHOLE)
    assert table.rows[1] == Row(with_="b", size=None)
    assert table.values.shape == (1, 2)
    assert (table.nulls, table.further) == (("sure",), {"other": {"any": [1, None]}})


def test_none_is_left_out_where_it_is_the_default():
    assert to_document(Table(count=1)) == {"count": 1, "rows": []}
    assert to_document(Table(count=1, nulls=("sure",))) == {"count": 1, "rows": [], "sure": None}
    assert to_document(Row(with_="a", size=None)) == {"with": "a", "size": None}
    assert to_document(Table(count=1, values=np.eye(2)))["values"] == [[1.0, 0.0], [0.0, 1.0]]


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"count": 1.5}, "table.count is 1.5: an integer is expected."),
        ({"count": True}, "table.count is True: an integer is expected."),
        ({"sure": 1}, "table.sure is 1: true or false is expected."),
        ({"rows": {}}, "table.rows is {}: a list is expected."),
        ({"rows": [3]}, "table.rows.0 is 3: an object with keys is expected."),
        ({"rows": [{"with": 3, "size": 1.0}]}, "table.rows.0.with is 3: a text is expected."),
        ({"rows": [{"with": "a"}]}, "table.rows.0.size is missing: the file was edited or truncated."),
        (
            {"rows": [{"with": "a", "size": 1.0, "sise": 2.0}]},
            "table.rows.0 has an unknown key, sise (did you mean size?): remove it.",
        ),
        ({"by_name": {"x": {"with": "a", "size": "1"}}}, "table.by_name.x.size is '1': a finite number is expected."),
        ({"by_name": {"x": {"with": "a", "size": 10**400}}}, "a finite number is expected."),
        ({"pair": [1]}, "table.pair is [1]: a list of 2 is expected."),
        ({"values": [[1.0], [1.0, 2.0]]}, "table.values is [[1.0], [1.0, 2.0]]: a list of finite numbers is expected."),
        ({"values": 1.0}, "a list of finite numbers is expected."),
        ({"values": ["1"]}, "a list of finite numbers is expected."),
        ({"origin": 3}, "table.origin is 3: an object with keys is expected."),
    ],
)
def test_a_message_names_the_key_and_what_is_expected(change, sentence):
    with pytest.raises(srt.InputError) as caught:
        from_document(Table, WHOLE | change, "table")
    assert str(caught.value).endswith(sentence)
