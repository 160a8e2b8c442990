"""Report pages and plots: of a diagnosis, of a model that was identified, and of a campaign."""

from residua.facade import hand_on

hand_on(__name__)
