"""Every kind of input that is tried, by name."""

from __future__ import annotations

from . import chunks, contents, formats, nodes, recordings, tables, texts
from .harness import Kind

KINDS: dict[str, Kind] = {
    "recording": recordings.stored,
    "chunks": chunks.chunks,
    "message": recordings.recorded,
    "contents": contents.contents,
    "compare": recordings.compared,
    "diagnose": recordings.diagnosed,
    "text": texts.files,
    "formula": texts.formulas,
    "typed": texts.words,
    "csv": tables.csv,
    "parquet": tables.parquet,
    "format": formats.formats,
    "graph": nodes.graph,
    "heard": nodes.heard,
}
