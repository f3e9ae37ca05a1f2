"""Tables on a terminal: no line is wider than it, and nothing is lost."""

import io

import pytest
from rich.console import Console
from rich.table import Table as RichTable

from torchreg.benchmark.core.tables import Table, markdown_table, narrow_parts, shown_parts

HEAD = ["method", "size", "registration recall", "inlier ratio", "seconds", "ended with an error"]
ROWS = [
    [
        f"a method with a long name {k // 2}",
        f"{10**k:,} points",
        "0.811 [0.676, 0.919]",
        "0.160 [0.112, 0.211]",
        "1",
        "0",
    ]
    for k in range(4)
]


@pytest.mark.parametrize("width", [80, 100, 120, 400])
def test_a_wide_table_fits_and_loses_nothing(width):
    parts = narrow_parts(Table("All pairs", HEAD, ROWS), width)
    stream = io.StringIO()
    console = Console(file=stream, width=width, markup=False)
    for part in parts:
        table = RichTable(*part.head, title=part.heading or None)
        for row in part.rows:
            table.add_row(*row)
        console.print(table)
    text = stream.getvalue()
    assert all(len(line.rstrip()) <= width for line in text.splitlines())
    for row in ROWS:
        assert all(cell in text for cell in row), "a cell was broken into lines"
    heads = [" ".join(head.split()) for part in parts for head in part.head]
    assert list(dict.fromkeys(heads)) == HEAD
    assert all(part.head[:2] == parts[0].head[:2] for part in parts)  # method and size: together they tell rows apart
    assert (len(parts) == 1) == (width >= 120)


def test_a_document_comes_apart_into_sentences_and_tables():
    table = Table("Peak memory", HEAD, ROWS)
    text = f"A caption.\n\n{markdown_table(HEAD, ROWS)}\n\nPeak memory:\n\n{markdown_table(HEAD, ROWS)}\n"
    assert shown_parts(text) == ["A caption.", table._replace(heading=""), table]
