"""Residual generators and observers: one method, one file."""

from residua.facade import hand_on

hand_on(__name__)
