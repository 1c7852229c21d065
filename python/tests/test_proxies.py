"""Proxies between a program and its farm."""

import socket

import pytest

import resin_farm


@pytest.mark.parametrize("variable", ["http_proxy", "https_proxy", "grpc_proxy"])
def test_a_farm_of_this_machine_is_not_asked_by_a_proxy(
    farm: resin_farm.Farm, monkeypatch: pytest.MonkeyPatch, variable: str
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as proxy:
        for name in ("no_proxy", "no_grpc_proxy", "NO_PROXY"):
            monkeypatch.delenv(name, raising=False)
        monkeypatch.setenv(variable, f"http://127.0.0.1:{proxy.getsockname()[1]}")
        for host in ("127.0.0.1", "localhost"):
            found = resin_farm.Farm.connect(farm.address.replace("127.0.0.1", host))
            assert found.dictionaries()
            found.close()
        proxy.settimeout(0)
        with pytest.raises(BlockingIOError):
            proxy.accept()
