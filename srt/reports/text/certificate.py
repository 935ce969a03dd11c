"""Text of a certificate: its main results and the table of the parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING

from srt.reports.text.tables import text_table, wrap

if TYPE_CHECKING:
    from srt.reports.certificate.content import Certificate


def certificate_text(certificate: Certificate) -> str:
    """Title, main results and parameters of a certificate."""
    table = certificate.parameters
    rows = [[cell.text for cell in row] for row in table.rows]
    lines = [certificate.title, *(line for sentence in certificate.summary for line in wrap(sentence))]
    return "\n".join([*lines, "", text_table(list(table.head), rows, table.alignment, gap=1)])
