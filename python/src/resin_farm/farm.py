"""A farm: it computes dictionaries, and fits measurements to them."""

from __future__ import annotations

import logging
import os
import pathlib
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Literal, Self, TypeAlias, TypeVar, Unpack

from google.protobuf.message import Message

from resin_farm import _connection, _decode, _display, _programs, design, maps, options, profile, results
from resin_farm._local import LocalFarm, folder_of
from resin_farm._wire import dictionaries_pb2, fits_pb2, model_pb2
from resin_farm.capture import Capture
from resin_farm.dictionary import Dictionary
from resin_farm.errors import Deleted, FarmError, InvalidArgument, Unavailable
from resin_farm.grid import Grid
from resin_farm.measurement import Measurement, checked, read_measurements, warn

if TYPE_CHECKING:
    import pandas

Answer = TypeVar("Answer", bound=Message)

# Without a handler its warnings go to standard error.
_log = logging.getLogger("resin_farm")

# Seconds that a call may take, and one that may read a large database or fit a million pixels.
_CALL_S = 300.0
_PATIENT_S = 12 * 3600.0
_PATIENT = ("Fits/Fit", "Fits/Map", "Fits/Measure", "Dictionaries/Delete")
# A stream is asked for anew after so many seconds: a link that leads nowhere is found out, whatever answers its pings.
_STREAM_S = 60.0
_PAUSE_S = 1.0
# Seconds in which a coordinator that is asked to end turns calls away, and has then ended.
_ABOUT_TO_END = 2.0

Path: TypeAlias = str | os.PathLike[str]
Materials: TypeAlias = "list[Measurement] | tuple[Measurement, ...] | Measurement | pandas.DataFrame | Path"


class Farm:
    """A farm of this machine, with its data in a folder; `Farm.connect` finds one that runs elsewhere.

    It starts when it is opened, with a worker on all cores, and ends with `close`, with the `with` block, or with this
    process. Several programs may open the same folder at once.

    A farm that is handed to another process of `multiprocessing` ("spawn" or "forkserver") is opened there anew. In a
    fork of this process its calls raise a `FarmError`.
    """

    def __init__(self, folder: Path = "farm-data") -> None:
        """Opens the farm of a folder, which is made if it is not there.

        Raises:
            FarmError: if it does not start.
        """
        self._begin(folder_of(folder), None)
        self._open()

    def _begin(self, folder: pathlib.Path | None, where: str | None) -> None:
        """One of a folder, or one at a URL or of an access file, that is opened when it is used."""
        self._folder = folder
        self._where = where
        self._local: LocalFarm | None = None
        self._connection: _connection.Connection | None = None
        self._closed = False
        # Threads may find at once that the farm has gone: one of them looks for it.
        self._looking = threading.Lock()

    @classmethod
    def connect(cls, where: Path) -> Self:
        """The farm of an access file (as `client.toml`), or at a URL of this machine (as "http://127.0.0.1:7700")."""
        farm = cls.__new__(cls)
        farm._begin(None, os.fspath(where))
        farm._open()
        return farm

    @property
    def address(self) -> str:
        return (self._connection or self._open()).address

    # Dictionaries.

    def submit(
        self,
        grid: Grid | Path | None = None,
        name: str | None = None,
        *,
        quality: Literal["draft", "paper", "fine"] | None = None,
        priority: int = 0,
        wait: bool = True,
        progress: bool = True,
    ) -> Dictionary:
        """Computes a dictionary; if it exists with the same grid, carries on with it.

        Args:
            grid: a grid, or the path of a grid file; the paper's if None.
            name: if None the file's name, "grid" for a `Grid`, "paper" for the paper's.
            quality: how quiet the records are to be, instead of what the grid says.
            priority: from -1000 to 1000; higher goes first.
            wait: wait until it is done.
            progress: meanwhile tell on standard error how far it is.
        """
        arguments = [*self._arguments(), "submit", f"--priority={priority}"]
        arguments += [f"--quality={quality}"] if quality else []
        if not isinstance(grid, Grid):
            arguments += [f"--name={name}"] if name else []
            found = _programs.farmctl(arguments + ([os.fspath(grid)] if grid is not None else []))
        else:
            with tempfile.TemporaryDirectory() as folder:
                # The file's name is the dictionary's.
                file = pathlib.Path(folder, "paper.toml" if grid == Grid() else "grid.toml")
                file.write_text(grid.to_toml(), encoding="utf-8")
                found = _programs.farmctl([*arguments, *([f"--name={name}"] if name else []), str(file)])
        dictionary = self.dictionary(found["name"])
        if dictionary._status.grid_digest != found["grid_digest"]:
            raise Deleted(f"dictionary {dictionary.name} was replaced as soon as it was submitted")
        return dictionary.wait(progress=progress) if wait else dictionary

    def dictionary(self, name: str | None = None) -> Dictionary:
        """A dictionary by its name; without a name the only one, or "paper".

        Raises:
            NotFound: if there is none of this name.
        """
        request = dictionaries_pb2.GetRequest(name=self._name(name))
        return Dictionary(self, self._call("Dictionaries/Get", request, dictionaries_pb2.Dictionary))

    def dictionaries(self) -> list[Dictionary]:
        """All dictionaries, in the order of their creation."""
        found: list[Dictionary] = []
        token = ""
        while True:
            request = dictionaries_pb2.ListRequest(page_token=token)
            answer = self._call("Dictionaries/List", request, dictionaries_pb2.ListResponse)
            found += [Dictionary(self, one) for one in answer.dictionaries]
            token = answer.next_page_token
            if not token:
                return found

    # Fits.

    def fit(
        self,
        measurement: Materials,
        dictionary: str | None = None,
        *,
        refine: bool = True,
        **told: Unpack[options.FitOptions],
    ) -> results.MaterialFit:
        """The media that best explain a material's profiles, channel by channel, with error bars.

        Args:
            measurement: of one material: a `Measurement`, a frame or a file with the columns of a measurement file.
            dictionary: its name; the only one or "paper" if None.
            refine: go on from the best record to a continuous optimum.
            told: as far as they are known, the options of `FitOptions`, as `g=0.4` or `sigma_t_per_mm=(4, 8)`.

        Raises:
            InvalidArgument: with what is wrong with a value; `fields` names it.
        """
        material = _one(measurement)
        request = fits_pb2.FitRequest(
            dictionary=self._name(dictionary),
            measurement=material._wire(),
            options=options.wire(told, refine=refine),
        )
        answer = self._call("Fits/Fit", request, fits_pb2.FitResponse)
        return _decode.material_fit(answer.fit, options.assumed(told, [material]))

    def measure(
        self,
        materials: Materials | Capture,
        dictionary: str | None = None,
        *,
        free_g: bool = False,
        **told: Unpack[options.FitOptions],
    ) -> results.Measured:
        """The whole job for materials of one set-up: scale factor, common anisotropy, media with error bars.

        Args:
            materials: measurements, a frame, a measurement file, or what `capture` made of photographs. For the
                last, the session's own dictionary is computed if it is not there, its white reference is taken for
                the scale factor, and its report is completed.
            dictionary: its name; the only one or "paper" if None.
            free_g: let every channel have its own anisotropy.
            told: as far as they are known, the options of `FitOptions`. Without `mu` it is searched for.
        """
        folder = materials.folder if isinstance(materials, Capture) else _folder(materials)
        if folder is not None:
            if told:
                raise TypeError(f"{', '.join(told)}: what is known of a session is in its folder")
            arguments = ["measure", str(folder)] + (["--free-g"] if free_g else [])
            arguments += [f"--dictionary={dictionary}"] if dictionary else []
            found = _programs.farmctl([*self._arguments(), *arguments])
            warn(note["text"] for note in found["notes"])
            return _decode.measured_of_json(found)
        assert not isinstance(materials, Capture)
        measurements, name = _measurements(materials), self._name(dictionary)
        request = fits_pb2.MeasureRequest(
            dictionary=name,
            materials=[m._wire() for m in measurements],
            options=options.wire(told, refine=True),
            search_mu=None if "mu" in told else fits_pb2.MuRange(),
            common_g=not free_g,
        )
        answer = self._call("Fits/Measure", request, fits_pb2.MeasureResponse)
        return _decode.measured(answer, name, options.assumed(told, measurements))

    def map(
        self, measurement: Materials, dictionary: str | None = None, **told: Unpack[options.FitOptions]
    ) -> list[maps.DistanceMap]:
        """How far a material's profiles are from every medium of a dictionary, one map for each channel.

        Args:
            measurement: of one material, as for `fit`.
            dictionary: its name; the only one or "paper" if None.
            told: as far as they are known, the options of `FitOptions`.
        """
        request = fits_pb2.MapRequest(
            dictionary=self._name(dictionary),
            measurement=_one(measurement)._wire(),
            options=options.wire(told, refine=False),
        )
        answer = self._call("Fits/Map", request, fits_pb2.MapResponse)
        return [maps.DistanceMap._of_wire(one) for one in answer.maps]

    def design(
        self,
        medium: results.Medium,
        dictionary: str | None = None,
        *,
        slabs: Sequence[Sequence[float]] = (),
        shots: Sequence[int] = (),
        channel: str | None = None,
        noise: float | None = None,
        noise_floor: float | None = None,
        free_mu: bool = False,
        **told: Unpack[options.FitOptions],
    ) -> design.Design:
        """How well sets of slabs would determine a medium, before anything is photographed (Cramér–Rao bounds).

        Args:
            medium: a guess: how much pixels tell depends on what they look at.
            dictionary: its name; the only one or "paper" if None.
            slabs: sets of thicknesses in mm; sets of one to three of the dictionary's if there are none.
            shots: photographs of each slab; 1 and 2 if there are none.
            channel: the dictionary's first if None.
            noise: standard error of a pixel of one photograph, as a share of its value; 0.01 if None.
            noise_floor: that of a dark pixel, as a radiance factor; 0.0005 if None.
            free_mu: nothing is known of the scale factor.
            told: what is known of the set-up, as for `fit`.
        """
        request = fits_pb2.DesignRequest(
            dictionary=self._name(dictionary),
            channel=channel,
            medium=_wire_medium(medium),
            slab_sets=[fits_pb2.SlabThicknesses(thickness_mm=one) for one in slabs],
            shots=shots,
            noise=noise,
            noise_floor=noise_floor,
            set_up=options.wire(told, refine=False),
            mu_free=free_mu,
        )
        return design.of_wire(self._call("Fits/Design", request, fits_pb2.DesignResponse))

    def similar(self, medium: results.Medium, g: Sequence[float]) -> list[results.Medium]:
        """Media that similarity theory calls equal to one, at other anisotropies (Eqs. 4 to 6 of the paper)."""
        request = fits_pb2.SimilarRequest(medium=_wire_medium(medium), g=g)
        answer = self._call("Fits/Similar", request, fits_pb2.SimilarResponse)
        return [results.Medium._of_wire(one) for one in answer.media]

    # What needs no dictionary.

    def simulate(
        self,
        *,
        sigma_t: float,
        albedo: float,
        g: float,
        thickness_mm: float,
        scene: str = "paper",
        sample_ior: float = 1.53,
        walks: int = 50_000,
        seed: int = 1,
    ) -> profile.Profile:
        """Traces the profile of one medium on this machine; see `resin_farm.simulate`."""
        return profile.simulate(
            sigma_t=sigma_t,
            albedo=albedo,
            g=g,
            thickness_mm=thickness_mm,
            scene=scene,
            sample_ior=sample_ior,
            walks=walks,
            seed=seed,
        )

    def capture(self, session: Path, output: Path | None = None) -> Capture:
        """Turns the photographs of a session into profiles, with all that is known of the set-up and a report. What is
        not as it should be is a `MeasurementWarning`.

        Args:
            session: the session file.
            output: the folder to write; the session file's name without its ending if None.

        Raises:
            FarmError: with what was seen, where and what to do, if the photographs cannot be used.
        """
        folder = pathlib.Path(output) if output is not None else pathlib.Path(session).with_suffix("")
        found = _programs.farmctl(["capture", os.fspath(session), "--output", str(folder)])
        warn(found["warnings"])
        return Capture.read(folder)

    # The farm itself.

    def close(self) -> None:
        """Ends a farm of this machine, if this program started it; what is being computed goes on with the next."""
        self._closed = True
        if self._connection is not None:
            self._connection.close()
        if self._local is not None:
            self._local.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __reduce__(self) -> tuple[object, tuple[pathlib.Path | None, str | None]]:
        """As what opens it again, in another process that finds it running."""
        return _opened_later, (self._folder, self._where)

    def __repr__(self) -> str:
        return f"Farm({str(self._folder or self._where)!r})"

    def _repr_html_(self) -> str:
        rows = [[d.name, d.state, f"{d.records_done:,}", f"{d.records_total:,}"] for d in self.dictionaries()]
        return _display.html_table(("dictionary", "state", "records", "of"), rows, repr(self))

    def _arguments(self) -> list[str]:
        """How farmctl finds this farm."""
        if self._where is not None and not self._where.startswith("http://"):
            return ["--access", self._where]
        return ["--server", self.address]

    def _name(self, told: str | None) -> str:
        if told is not None:
            return told
        names = [dictionary.name for dictionary in self.dictionaries()]
        if len(names) == 1:
            return names[0]
        if "paper" in names:
            return "paper"
        if not names:
            raise FarmError("there is no dictionary yet: submit() computes the paper's")
        raise FarmError(f"there are several dictionaries: name one, of {', '.join(names)}")

    def _call(self, method: str, request: Message, answer: type[Answer]) -> Answer:
        connection, timeout_s = self._open(), _PATIENT_S if method in _PATIENT else _CALL_S
        try:
            return connection.call(method, request, answer.FromString, timeout_s)
        except Unavailable:
            if self._local is None:
                raise
        if connection.answers():
            # One that is about to end, or one that says why it cannot: then it says so again.
            time.sleep(_ABOUT_TO_END)
            try:
                return connection.call(method, request, answer.FromString, timeout_s)
            except Unavailable:
                if connection.answers():
                    raise
        self._find_again(connection)
        return self._open().call(method, request, answer.FromString, timeout_s)

    def _stream(self, method: str, request: Message, answer: type[Answer]) -> Iterator[Answer]:
        """The answers; goes on with a farm that was away, for as long as that takes, and says so."""
        away = False
        while True:
            connection, begun, came = self._open(), time.monotonic(), False
            try:
                for one in connection.stream(method, request, answer.FromString, _STREAM_S):
                    if away:
                        _log.warning("%r answers again", self)
                    away, came = False, True
                    yield one
                return
            except Unavailable as error:
                if came and time.monotonic() - begun >= _STREAM_S:
                    continue
                if not away:
                    _log.warning("%r does not answer and is waited for: %s", self, error.message)
                away = True
            time.sleep(_PAUSE_S)
            if self._local is None or connection.answers():
                self._connect_anew(connection)
                continue
            try:
                self._find_again(connection)
            except Unavailable:
                # One that is frozen may go on.
                continue

    def _open(self) -> _connection.Connection:
        if self._closed:
            raise FarmError(f"{self!r} is closed")
        if self._connection is None:
            with self._looking:
                if self._connection is None:
                    self._connection = self._connect()
        return self._connection

    def _connect(self) -> _connection.Connection:
        _connection.not_in_a_fork()
        if self._folder is not None:
            self._local = LocalFarm(self._folder)
            return self._local.connection()
        where = self._where or ""
        if where.startswith("http://"):
            return _connection.of_loopback(where)
        if where.startswith("https://"):
            raise FarmError(f"{where}: an access file is needed, which holds the certificate to know the farm by")
        return _connection.of_access_file(pathlib.Path(where))

    def _connect_anew(self, gone: _connection.Connection) -> None:
        """Leaves a connection that may lead nowhere; calls that wait on it are not broken off."""
        with self._looking:
            if self._connection is gone:
                self._connection = self._local.connection() if self._local else self._connect()

    def _find_again(self, gone: _connection.Connection) -> None:
        """After a farm of this machine has gone."""
        with self._looking:
            if self._connection is gone and self._local is not None:
                self._connection = self._local.find_again()
                gone.close()


def _opened_later(folder: pathlib.Path | None, where: str | None) -> Farm:
    """A farm from another process. Whoever unpickles it is not the one to learn that it cannot be opened."""
    farm = Farm.__new__(Farm)
    farm._begin(folder, where)
    return farm


def _folder(told: object) -> pathlib.Path | None:
    if not isinstance(told, str | os.PathLike):
        return None
    path = pathlib.Path(told)
    return path if path.is_dir() else None


def _wire_medium(medium: results.Medium) -> model_pb2.Medium:
    return model_pb2.Medium(sigma_t_per_mm=medium.sigma_t_per_mm, albedo=medium.albedo, g=medium.g)


def _one(told: Materials) -> Measurement:
    materials = _measurements(told)
    if len(materials) != 1:
        names = ", ".join(m.material for m in materials)
        raise InvalidArgument(f"one material is wanted, and these are {names}: measure takes all")
    return materials[0]


def _measurements(told: Materials) -> list[Measurement]:
    if isinstance(told, Measurement):
        return checked([told])
    if isinstance(told, str | os.PathLike):
        return read_measurements(told)
    if isinstance(told, list | tuple):
        return checked(told)
    return Measurement.from_pandas(told)
