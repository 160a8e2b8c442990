"""Report pages and plots: of a diagnosis, and of a model that was identified."""

from residua.report.model_page import write_model_page
from residua.report.page import Section, Table, write_demo_page, write_page

__all__ = ["Section", "Table", "write_demo_page", "write_model_page", "write_page"]
