"""Report pages and plots: of a diagnosis, of a model that was identified, and of a campaign."""

from typing import TYPE_CHECKING

from residua.facade import hand_on

if TYPE_CHECKING:
    from residua.report.campaign_page import write_campaign_page
    from residua.report.model_page import write_model_page
    from residua.report.page import Section, Table, write_demo_page, write_page

__all__ = ["Section", "Table", "write_campaign_page", "write_demo_page", "write_model_page", "write_page"]

hand_on(
    __name__,
    {
        "residua.report.campaign_page": ("write_campaign_page",),
        "residua.report.model_page": ("write_model_page",),
        "residua.report.page": ("Section", "Table", "write_demo_page", "write_page"),
    },
)
