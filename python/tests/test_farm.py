"""Farms start, end, and are found again."""

import os
import pathlib
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import resin_farm
from conftest import GRID, WHITE
from resin_farm import _programs

# Some seconds of work.
SLOW = resin_farm.Grid(
    sigma_t_per_mm=[4, 8, 16, 24], albedo=[0.9], g=[0.0, 0.2, 0.4, 0.6], thickness_mm=[0.5, 1], walks=400_000
)
SMALL = resin_farm.Grid(sigma_t_per_mm=[4, 8], albedo=[0.9], g=[0.0], thickness_mm=[1], walks=5000)


def test_the_farm_of_a_folder_ends_with_its_block_and_carries_on(tmp_path: pathlib.Path) -> None:
    with resin_farm.Farm(tmp_path / "data") as farm:
        first = farm.submit(SMALL, "small")
        assert first.state == "done" and first.records_done == 2
        digest = first.records_digest
    assert not (tmp_path / "data" / "coordinator.addr").exists()
    with resin_farm.Farm(tmp_path / "data") as farm:
        assert farm.dictionary("small").records_digest == digest
        assert farm.submit(SMALL, "small").records_digest == digest
        assert [d.name for d in farm.dictionaries()] == ["small"]
        assert farm.dictionary("small").delete() == 2


def test_a_farm_that_another_process_holds_is_shared_and_taken_over(tmp_path: pathlib.Path) -> None:
    first = resin_farm.Farm(tmp_path)
    second = resin_farm.Farm(tmp_path)
    assert second.address == first.address
    first.submit(SMALL, "small", progress=False)
    first.close()
    assert second.dictionary("small").state == "done"
    assert second.address != first.address
    second.close()


def test_a_farm_that_was_killed_is_started_anew(tmp_path: pathlib.Path) -> None:
    with resin_farm.Farm(tmp_path) as farm:
        farm.submit(SMALL, "small", progress=False)
        assert farm._local is not None
        farm._local._process.kill()
        # Several threads notice at once.
        with ThreadPoolExecutor(4) as threads:
            found = list(threads.map(lambda _: farm.dictionary("small").state, range(8)))
        assert found == ["done"] * 8
    with pytest.raises(resin_farm.FarmError, match="is closed"):
        farm.dictionaries()
    farm.close()


def test_a_farm_that_is_killed_while_it_computes_goes_on(tmp_path: pathlib.Path) -> None:
    with resin_farm.Farm(tmp_path) as farm:
        farm.submit(SLOW, "slow", wait=False)
        assert farm._local is not None
        threading.Timer(0.5, farm._local._process.kill).start()
        assert farm.dictionary("slow").wait(progress=False).records_done == 32


def test_a_farm_ends_when_its_program_is_killed(tmp_path: pathlib.Path) -> None:
    code = f"import resin_farm, time\nresin_farm.Farm({str(tmp_path)!r})\nprint('up', flush=True)\ntime.sleep(600)"
    # Without a name the farm would be garbage-collected at once.
    code = code.replace("\nresin_farm.Farm", "\nfarm = resin_farm.Farm")
    program = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, encoding="utf-8")
    assert program.stdout is not None and program.stdout.readline() == "up\n"
    assert (tmp_path / "coordinator.addr").exists()
    program.send_signal(signal.SIGKILL)
    program.wait()
    end = time.monotonic() + 30
    while (tmp_path / "coordinator.addr").exists():
        assert time.monotonic() < end, "the farm outlives its program"
        time.sleep(0.1)
    program.stdout.close()


def test_what_does_not_start_says_why(tmp_path: pathlib.Path) -> None:
    file = tmp_path / "file"
    file.write_text("no folder", encoding="utf-8")
    with pytest.raises(resin_farm.FarmError, match="does not start"):
        resin_farm.Farm(file)


def test_grids_that_are_not_valid_are_refused_with_the_field(farm: resin_farm.Farm) -> None:
    with pytest.raises(resin_farm.InvalidArgument, match=r"^the grid: albedo\[1\] = 1\.5 is not valid"):
        farm.submit(resin_farm.Grid(albedo=[0.5, 1.5]), "bad")
    with pytest.raises(resin_farm.FarmError, match="draft"):
        farm.submit(GRID, "bad", quality="best")  # type: ignore[arg-type]
    with pytest.raises(resin_farm.NotFound, match="bad"):
        farm.dictionary("bad")


def test_grids_take_arrays_and_can_be_compared(tmp_path: pathlib.Path) -> None:
    grid = resin_farm.Grid(sigma_t_per_mm=np.array([4, 8]), albedo=[0.9], g=[0], thickness_mm=[1], walks=5000)
    assert grid == SMALL and grid != resin_farm.Grid()
    with resin_farm.Farm(tmp_path) as farm:
        assert farm.submit(grid, progress=False).name == "grid"
    with pytest.raises(TypeError, match=r"g: 0\.4: an axis is a list"):
        resin_farm.Grid(g=0.4)  # type: ignore[arg-type]


def test_without_a_dictionary_the_error_says_what_to_do(tmp_path: pathlib.Path, white: resin_farm.Measurement) -> None:
    with resin_farm.Farm(tmp_path) as farm, pytest.raises(resin_farm.FarmError, match=r"submit\(\)"):
        farm.fit(white)


def test_without_a_name_the_dictionary_is_that_of_farmctl(tmp_path: pathlib.Path) -> None:
    with resin_farm.Farm(tmp_path) as farm:
        for submitted, usual in [("fine", "fine"), ("paper", "fine"), ("lab", "lab")]:
            farm.submit(GRID, submitted, progress=False)
            assert farm.dictionary().name == usual
            arguments = ["--server", farm.address, "profile", "--sigma-t", "6", "--albedo", "0.999", "--g", "0.4"]
            found = _programs.farmctl([*arguments, "--thickness", "0.5"])
            assert found["dictionary"] == usual
        farm.submit(SMALL, "other", progress=False)
        assert farm.dictionary().name == "lab"
        for usual in ("lab", "paper"):
            farm.dictionary(usual).delete()
        with pytest.raises(resin_farm.FarmError, match="several dictionaries: name one, of "):
            farm.dictionary()


def test_a_coordinator_is_reached_by_its_access_file(tmp_path: pathlib.Path, white: resin_farm.Measurement) -> None:
    with resin_farm.Farm(tmp_path / "data") as farm:
        farm.submit(GRID, "grid", progress=False)
        expected = farm.fit(white, g=0.4)
    access = tmp_path / "access"
    _programs.farmctl(["access", "create", str(access), "--host", "localhost"])
    command = [_programs.program("farm-coordinator"), "--listen", "127.0.0.1:0", "--data", str(tmp_path / "data")]
    environment = os.environ | {"FARM_LOG": "warn"}
    coordinator = subprocess.Popen([*command, "--access", str(access / "coordinator.toml")], env=environment)
    try:
        address = tmp_path / "data" / "coordinator.addr"
        end = time.monotonic() + 30
        while not (address.exists() and address.read_text(encoding="utf-8").strip()):
            assert time.monotonic() < end, "the coordinator does not start"
            time.sleep(0.1)
        port = address.read_text(encoding="utf-8").strip().rpartition(":")[2]
        file = access / "client.toml"
        lines = [
            f'server = "https://localhost:{port}"' if line.startswith("server =") else line
            for line in file.read_text(encoding="utf-8").splitlines()
        ]
        file.write_text("\n".join(lines), encoding="utf-8")
        farm = resin_farm.Farm.connect(file)
        assert farm.fit(white, g=0.4)["R"].medium == expected["R"].medium
        assert farm.dictionary("grid").explain()
        farm.close()
        wrong = access / "wrong.toml"
        text = [
            f'token = "{"x" * 43}"' if line.startswith("token =") else line
            for line in file.read_text(encoding="utf-8").splitlines()
        ]
        wrong.write_text("\n".join(text), encoding="utf-8")
        stranger = resin_farm.Farm.connect(wrong)
        with pytest.raises(resin_farm.Refused):
            stranger.dictionaries()
        stranger.close()
    finally:
        coordinator.terminate()
        coordinator.wait()
    with pytest.raises(resin_farm.Unavailable):
        resin_farm.Farm.connect(f"http://127.0.0.1:{port}").dictionaries()
    with pytest.raises(resin_farm.FarmError, match="access file"):
        resin_farm.Farm.connect("https://farm.example.org")


def test_a_capture_is_measured_with_its_own_dictionary(tmp_path: pathlib.Path) -> None:
    with resin_farm.Farm(tmp_path / "data") as farm:
        session = WHITE.parent / "session" / "session.toml"
        capture = farm.capture(session, tmp_path / "white")
        (material,) = capture.measurements
        assert material.channels == ("R", "G", "B") and capture.report.exists()
        assert material.profiles[0].std_errors is not None and "origin_mm" in material.profiles[0].set_up
        # A coarse grid, to save time.
        grid = capture.folder / "grid.toml"
        thicknesses = ", ".join(f"{t:g}" for t in material.thicknesses_mm)
        grid.write_text(
            'scene = "scene.toml"\nsigma_t_per_mm = [5, 6, 8, 10, 20, 28]\nalbedo = [0.998, 0.999, 0.9995, 0.9999]\n'
            f"g = [0.3, 0.4]\nthickness_mm = [{thicknesses}]\nsample_ior = [1.53]\nwalks = 10000\n",
            encoding="utf-8",
        )
        measured = farm.measure(capture)
        assert [fit.channel for fit in measured.materials[0].channels] == ["R", "G", "B"]
        # Estimated from the white reference and the data.
        assert abs(measured.mu - 1) < 0.03 and measured.mu_std_error < 0.02
        assert "media" in (capture.folder / "report.html").read_text(encoding="utf-8")
        assert farm.measure(str(capture.folder)).materials[0]["R"].medium == measured.materials[0]["R"].medium
        with pytest.raises(TypeError, match="folder"):
            farm.measure(capture, mu=1.0)
