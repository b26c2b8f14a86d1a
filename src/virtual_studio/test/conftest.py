import pytest


@pytest.fixture
def address():
    """A loopback address at which no camera is."""
    from virtual_studio.gige import free_addresses

    return free_addresses(1)[0]


@pytest.fixture
def aravis():
    """Aravis, Gio and GLib; skips where they are not installed."""
    from gige_client import import_aravis

    modules = import_aravis()
    if modules is None:
        pytest.skip("Aravis is not installed (apt install python3-gi gir1.2-aravis-0.8)")
    return modules
