"""Commands ``simulate zonguldak`` and ``simulate block``: synthetic data in the real file formats."""

from __future__ import annotations

import typer

app = typer.Typer(help="Write synthetic projects in the real file formats, with the truth beside them.")
