"""Plants: linear systems whose inputs have roles, from arrays, files and other packages."""

from residua.facade import hand_on

hand_on(__name__)
