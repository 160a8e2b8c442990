from residua.report.campaign_page import write_campaign_page as write_campaign_page
from residua.report.model_page import write_model_page as write_model_page
from residua.report.page import (
    Section as Section,
    Table as Table,
    write_demo_page as write_demo_page,
    write_page as write_page,
)
