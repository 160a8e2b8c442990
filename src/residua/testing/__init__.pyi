from residua.testing.kinds import check_isolation as check_isolation, check_test as check_test
from residua.testing.residual_generator import check_residual_generator as check_residual_generator
