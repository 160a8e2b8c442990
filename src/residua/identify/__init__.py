"""Plants and residual generators from recordings: one method, one file."""

__all__: list[str] = []
