"""The report of a demo: one self-contained page, drawn from its results alone."""

from .page import report_page

__all__ = ["report_page"]
