"""Computes dictionaries on a farm, and fits measurements to them."""

from __future__ import annotations

import os
import pathlib
import tempfile
from collections.abc import Sequence
from typing import Literal, Self, Unpack

from resin_farm import _decode, _display, _inputs, _programs, design, maps, options, profile, results
from resin_farm._access import FarmAccess
from resin_farm._inputs import Materials, Path
from resin_farm._local import folder_of
from resin_farm._wire import dictionaries_pb2, fits_pb2
from resin_farm.capture import Capture
from resin_farm.dictionary import Dictionary
from resin_farm.errors import Deleted, FarmError, InvalidArgument
from resin_farm.grid import Grid
from resin_farm.measurement import Measurement, warn, write
from resin_farm.medium import Medium

# Defaults among several dictionaries, in order of preference; the same as in farmctl.
# The default of questions, and the dictionary that must be named.
_USUAL, _NAMED_ONLY = "lab", "paper"


class Farm(FarmAccess):
    """A farm of this machine, with its data in a folder; `Farm.connect` opens one that runs elsewhere.

    It starts when it is opened, with a worker on all cores, and ends with `close`, with the `with` block, or with this
    process. Several programs may open the same folder at once.

    A farm that is handed to another process of `multiprocessing` ("spawn" or "forkserver") is opened there again. In a
    fork of this process its calls raise a `FarmError`.
    """

    def __init__(self, folder: Path = "farm-data") -> None:
        """Opens the farm of a folder.

        Args:
            folder: the folder of its data, which is created if it does not exist.

        Raises:
            FarmError: if it does not start.
        """
        self._begin(folder_of(folder), None)
        self._open()

    @classmethod
    def connect(cls, where: Path) -> Self:
        """Opens a farm that runs already.

        Args:
            where: its access file (`client.toml`), or its URL on this machine, such as "http://127.0.0.1:7700".

        Raises:
            OSError: if the access file cannot be read.
            FarmError: if something is missing in it, or the URL needs one.
            Refused: if another user of this machine holds the port.
        """
        farm = cls.__new__(cls)
        farm._begin(None, os.fspath(where))
        farm._open()
        return farm

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
        """Computes a dictionary; if it exists with the same grid, continues it.

        Args:
            grid: a grid, the path of a grid file, or "lab" for a laboratory's own measurements; the
                paper's grid if None.
            name: if None the file's name, "grid" for a `Grid`, "lab" or "paper" for these two.
            quality: the noise of the records, instead of the grid's.
            priority: from -1000 to 1000; higher goes first.
            wait: wait until it is done.
            progress: show the progress on standard error meanwhile.

        Returns:
            the dictionary, which is done if it was waited for.

        Raises:
            InvalidArgument: if a value of the grid is out of its range.
            FarmError: if there is a dictionary of this name with another grid, or if it ends otherwise than done.
        """
        arguments = [*self._arguments(), "submit", f"--priority={priority}"]
        arguments += [f"--quality={quality}"] if quality else []
        arguments += [f"--name={name}"] if name else []
        if isinstance(grid, Grid):
            found = _inputs.submitted(grid, arguments)
        else:
            found = _programs.farmctl(arguments + ([os.fspath(grid)] if grid is not None else []))
        dictionary = self.dictionary(found["name"])
        if dictionary._status.grid_digest != found["grid_digest"]:
            raise Deleted(f"dictionary {dictionary.name} was replaced as soon as it was submitted")
        return dictionary.wait(progress=progress) if wait else dictionary

    def dictionary(self, name: str | None = None) -> Dictionary:
        """A dictionary by its name.

        Args:
            name: its name; "lab", else the only one but "paper" if None.

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
        **given: Unpack[options.FitOptions],
    ) -> results.MaterialFit:
        """The media that best explain a material's profiles, channel by channel, with error bars.

        Args:
            measurement: of one material: a `Measurement`, a frame or a file with the columns of a measurement file.
            dictionary: its name; "lab", else the only one but "paper" if None.
            refine: continue from the best record to a continuous optimum.
            given: the options of `FitOptions` that are known, such as `g=0.4` or `sigma_t_per_mm=(4, 8)`.

        Returns:
            one `ChannelFit` for each channel of the material.

        Raises:
            InvalidArgument: if a value is not valid, of the measurement or an option; `fields` names it.
            NotFound: if there is no such dictionary.
            TypeError: if there is no such option.
        """
        material = _inputs.one(measurement)
        request = fits_pb2.FitRequest(
            dictionary=self._name(dictionary),
            measurement=material._wire(),
            options=options.wire(given, refine=refine),
        )
        answer = self._call("Fits/Fit", request, fits_pb2.FitResponse)
        return _decode.material_fit(answer.fit, options.assumed(given, [material]))

    def measure(
        self,
        materials: Materials | Capture,
        dictionary: str | None = None,
        *,
        free_g: bool = False,
        g_spread: float | None = None,
        g_change: float | None = None,
        output: Path | None = None,
        **given: Unpack[options.FitOptions],
    ) -> results.Measured:
        """All steps for materials of one set-up: scale factor, anisotropies, media with error bars.

        Args:
            materials: measurements, a frame, a measurement file, or the answer of `capture`. For the last, the
                session's own dictionary is computed unless it exists, the scale factor comes from its white reference,
                and its report is completed.
            dictionary: its name; "lab", else the only one but "paper" if None.
            free_g: let every channel have its own anisotropy.
            g_spread: standard deviation of ln(1 − g) of a material about the mean of all; estimated from the data if
                None, and 0 for one anisotropy.
            g_change: where channels are wavelengths, standard deviation of the change of ln(1 − g) over 100 nm; 0.1 if
                None, and 0 for one anisotropy.
            output: a folder to write: the table, `media.json` for `predict`, a statement of uncertainty, and media for
                Mitsuba 3, pbrt-v4 and Blender. A session's folder has them without it.
            given: the options of `FitOptions` that are known. Without `mu`, the scale factor is estimated.

        Returns:
            the fits of all materials with what they share. Doubts cause a `MeasurementWarning`.

        Raises:
            InvalidArgument: if a value is not valid, of a measurement or an option; `fields` names it.
            NotFound: if there is no such dictionary.
            TypeError: if there is no such option, or if options are given for a session, whose folder has them.
        """
        common = ["--free-g"] if free_g else []
        common += [] if g_spread is None else [f"--g-spread={g_spread}"]
        common += [] if g_change is None else [f"--g-change={g_change}"]
        common += [] if output is None else [f"--output={os.fspath(output)}"]
        folder = materials.folder if isinstance(materials, Capture) else _inputs.folder(materials)
        if folder is not None:
            if given:
                raise TypeError(f"{', '.join(given)}: the options of a session are in its folder")
            common += [f"--dictionary={dictionary}"] if dictionary else []
            found = _programs.farmctl([*self._arguments(), "measure", str(folder), *common])
            warn(note["text"] for note in found["notes"])
            return _decode.measured_of_json(found)
        assert not isinstance(materials, Capture)
        if output is not None:
            common += [f"--dictionary={self._name(dictionary)}", *options.flags(given)]
            return self._written(_inputs.measurements(materials), common)
        measurements, name = _inputs.measurements(materials), self._name(dictionary)
        request = fits_pb2.MeasureRequest(
            dictionary=name,
            materials=[m._wire() for m in measurements],
            options=options.wire(given, refine=True),
            search_mu=None if "mu" in given else fits_pb2.MuRange(),
            common_g=not free_g,
            g_spread=g_spread,
            g_change=g_change,
        )
        answer = self._call("Fits/Measure", request, fits_pb2.MeasureResponse)
        return _decode.measured(answer, name, options.assumed(given, measurements))

    def _written(self, measurements: list[Measurement], arguments: list[str]) -> results.Measured:
        """Measures by farmctl, which writes the folder that its arguments name."""
        with tempfile.TemporaryDirectory() as folder:
            file = pathlib.Path(folder, "measurement.csv")
            write(measurements, file)
            found = _programs.farmctl([*self._arguments(), "measure", str(file), *arguments])
        return _decode.measured_of_json(found)

    def map(
        self, measurement: Materials, dictionary: str | None = None, **given: Unpack[options.FitOptions]
    ) -> list[maps.DistanceMap]:
        """The distance of a material's profiles to every medium of a dictionary, one map for each channel.

        Args:
            measurement: of one material, as for `fit`.
            dictionary: its name; "lab", else the only one but "paper" if None.
            given: the options of `FitOptions` that are known.

        Returns:
            one map for each channel.

        Raises:
            InvalidArgument: if a value is not valid; `fields` names it.
            NotFound: if there is no such dictionary.
        """
        request = fits_pb2.MapRequest(
            dictionary=self._name(dictionary),
            measurement=_inputs.one(measurement)._wire(),
            options=options.wire(given, refine=False),
        )
        answer = self._call("Fits/Map", request, fits_pb2.MapResponse)
        return [maps.DistanceMap._of_wire(one) for one in answer.maps]

    def design(
        self,
        medium: Medium,
        dictionary: str | None = None,
        *,
        slabs_mm: Sequence[Sequence[float]] = (),
        shots: Sequence[int] = (),
        channel: str | None = None,
        noise: float | None = None,
        noise_floor: float | None = None,
        free_mu: bool = False,
        **given: Unpack[options.FitOptions],
    ) -> design.Design:
        """The precision with which sets of slabs would determine a medium, before any photograph (Cramér–Rao bounds).

        Args:
            medium: a guess: the information in the pixels depends on the medium.
            dictionary: its name; "lab", else the only one but "paper" if None.
            slabs_mm: sets of thicknesses in mm; sets of one to three of the dictionary's if there are none.
            shots: photographs of each slab; 1 and 2 if there are none.
            channel: the dictionary's first if None.
            noise: standard error of a pixel of one photograph, as a share of its value; 0.01 if None.
            noise_floor: standard error of a dark pixel, as a radiance factor; 0.0005 if None.
            free_mu: the scale factor has no prior.
            given: options about the set-up, as for `fit`.

        Raises:
            InvalidArgument: if a value is not valid, such as a thickness that is not near one of the dictionary's.
            NotFound: if there is no such dictionary.
        """
        request = fits_pb2.DesignRequest(
            dictionary=self._name(dictionary),
            channel=channel,
            medium=_inputs.wire_medium(medium),
            slab_sets=[fits_pb2.SlabThicknesses(thickness_mm=one) for one in slabs_mm],
            shots=shots,
            noise=noise,
            noise_floor=noise_floor,
            set_up=options.wire(given, refine=False),
            mu_free=free_mu,
        )
        try:
            return design.of_wire(self._call("Fits/Design", request, fits_pb2.DesignResponse))
        except InvalidArgument as error:
            # The interface has another name for this argument.
            fields = {field.replace("slab_sets", "slabs_mm"): allowed for field, allowed in error.fields.items()}
            raise InvalidArgument(error.message.replace("slab_sets", "slabs_mm"), fields) from None

    def similar(self, medium: Medium, g: Sequence[float]) -> list[Medium]:
        """Media that are equivalent to one by similarity theory (Eqs. 4 to 6 of the paper).

        Args:
            medium: the medium.
            g: the anisotropies of the equivalent media.

        Returns:
            one medium for each anisotropy, with the same σ_s (1 − g) and σ_a.

        Raises:
            InvalidArgument: if a value is not valid.
        """
        request = fits_pb2.SimilarRequest(medium=_inputs.wire_medium(medium), g=g)
        answer = self._call("Fits/Similar", request, fits_pb2.SimilarResponse)
        return [Medium._of_wire(one) for one in answer.media]

    # Without a dictionary.

    def simulate(
        self,
        *,
        sigma_t_per_mm: float,
        albedo: float,
        g: float,
        thickness_mm: float,
        scene: str = "lab",
        sample_ior: float = 1.53,
        walks: int = 50_000,
        seed: int = 1,
    ) -> profile.Profile:
        """Traces the profile of one medium on this machine, as the function `simulate` does.

        Args:
            sigma_t_per_mm: extinction coefficient, in 1/mm.
            albedo: single-scattering albedo.
            g: anisotropy, the mean cosine of the phase function, whose shape is the scene's.
            thickness_mm: thickness of the slab, in mm.
            scene: "lab", "paper", "smooth" or the path of a scene file.
            sample_ior: refractive index of the slab.
            walks: random walks, a multiple of 500 from 1,000 on.
            seed: seed of the random numbers.

        Raises:
            InvalidArgument: if an argument is not valid; it names it.
        """
        return profile.simulate(
            sigma_t_per_mm=sigma_t_per_mm,
            albedo=albedo,
            g=g,
            thickness_mm=thickness_mm,
            scene=scene,
            sample_ior=sample_ior,
            walks=walks,
            seed=seed,
        )

    def capture(self, session: Path, output: Path | None = None) -> Capture:
        """Turns the photographs of a session into profiles, with the set-up's parameters and a report. Doubtful
        photographs cause a `MeasurementWarning`.

        Args:
            session: the session file.
            output: the folder to write; the session file's name without its ending if None.

        Returns:
            the folder's measurements and set-up, for `measure`.

        Raises:
            FarmError: if the photographs cannot be used; its message names the photograph, the cause and the remedy.
        """
        folder = pathlib.Path(output) if output is not None else pathlib.Path(session).with_suffix("")
        found = _programs.farmctl(["capture", os.fspath(session), "--output", str(folder)])
        warn(found["warnings"])
        return Capture.read(folder)

    # The farm itself.

    def __reduce__(self) -> tuple[object, tuple[pathlib.Path | None, str | None]]:
        """Pickles the folder or the address, so that another process opens the farm there."""
        return _opened_later, (self._folder, self._where)

    def _repr_html_(self) -> str:
        rows = [[d.name, d.state, f"{d.records_done:,}", f"{d.records_total:,}"] for d in self.dictionaries()]
        return _display.html_table(("dictionary", "state", "records", "of"), rows, repr(self))

    def _name(self, given: str | None) -> str:
        """The given name; without one the usual dictionary, else the only one besides the paper's, as in farmctl."""
        if given is not None:
            return given
        # Those for all boards are asked with the board of a session, by farmctl.
        names = [dictionary.name for dictionary in self.dictionaries() if dictionary.channels[0] != "board 1"]
        others = [name for name in names if name != _NAMED_ONLY]
        if _USUAL in names or len(others) == 1:
            return _USUAL if _USUAL in names else others[0]
        if not names:
            raise FarmError(
                'there is no dictionary yet: submit("lab") computes one for a laboratory\'s own measurements, submit() '
                "the paper's"
            )
        if not others:
            raise FarmError(
                'there is only the paper\'s dictionary, whose rough surfaces lose light: submit("lab") computes one '
                "for a laboratory's own measurements, dictionary=\"paper\" asks the paper's"
            )
        raise FarmError(f"there are several dictionaries: name one, of {', '.join(names)}")


def _opened_later(folder: pathlib.Path | None, where: str | None) -> Farm:
    """A farm from another process. It is opened by its first call, so that unpickling does not fail."""
    farm = Farm.__new__(Farm)
    farm._begin(folder, where)
    return farm
