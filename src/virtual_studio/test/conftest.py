import pytest


@pytest.fixture
def address():
    """A loopback address at which no camera is."""
    from virtual_studio.gige import free_address

    return free_address()
