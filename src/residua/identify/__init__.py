"""Plants and residual generators from recordings: one method, one file."""

from residua.facade import hand_on

hand_on(__name__)
