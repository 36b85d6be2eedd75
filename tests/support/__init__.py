"""Helper functions and data for the tests. Fixtures are in conftest.py."""

import pytest

# Failed assertions in these modules show their values, as in tests.
pytest.register_assert_rewrite("support.commands", "support.files", "support.geometry")
