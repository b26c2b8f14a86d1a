import pytest


@pytest.fixture
def address():
    """A loopback address at which no camera is."""
    from virtual_studio.gige import free_addresses

    return free_addresses(1)[0]
