"""Report pages and plots: of a diagnosis, of a model that was identified, and of a campaign."""

from residua.report.campaign_page import write_campaign_page
from residua.report.model_page import write_model_page
from residua.report.page import Section, Table, write_demo_page, write_page

__all__ = ["Section", "Table", "write_campaign_page", "write_demo_page", "write_model_page", "write_page"]
