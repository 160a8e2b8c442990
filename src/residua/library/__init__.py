"""Ready-made plants, one file per paper or benchmark."""

from residua.facade import hand_on

hand_on(__name__)
