"""Report pages and plots of a diagnosis."""

from residua.report.page import Section, Table, write_demo_page, write_page

__all__ = ["Section", "Table", "write_demo_page", "write_page"]
