"""What the tests share; fixtures are in conftest.py."""

import pytest

# A failed assertion in here tells its values, as one in a test does.
pytest.register_assert_rewrite("support.commands", "support.files", "support.geometry")
