"""The settings and paths of a study's file, read without running any code that it names."""

from __future__ import annotations

import hashlib
import os
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from calib.errors.errors import InputError
from calib.errors.place import Place
from calib.errors.toml_places import Mark
from calib.measurement.accuracy import Accuracy, frf_claim
from calib.measurement.corrections import corrected
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.modal import MeasuredModes, Sensor
from calib.measurement.responses import MeasuredResponses, read_responses
from calib.results.fingerprint import code_files, digest_of
from calib.study.settings import StudySettings, TestSettings
from calib.study.study_text import find, place_of, read_layers, read_settings

Measured = MeasuredModes | MeasuredResponses | MeasuredFRFs

_READ: dict[str, Measured] = {}
"""Measurements by the digest of their files and settings, the latest last."""
_KEPT = 8


@dataclass(frozen=True)
class StudyPart:
    """One of the tests of a study.

    Attributes
    ----------
    index : int
        Position in the file, from 0.
    settings : TestSettings
    several : bool
        Whether the study has other tests.
    """

    index: int
    settings: TestSettings
    several: bool


@dataclass(frozen=True)
class StudyFile:
    """A study's file, read and checked without running any code that it names.

    Attributes
    ----------
    name : str
        Name of the study's folder; for one of several tests followed by that of the test.
    file : Path
        Its ``study.toml``.
    settings : StudySettings
        For one test those of a study with that test alone.
    part : Part or None
        Which of the tests under ``[[tests]]`` it is; None for a study with ``[measurement]``, and for all tests
        together.
    """

    name: str
    file: Path
    settings: StudySettings
    part: StudyPart | None = field(default=None, kw_only=True)

    @staticmethod
    def read(path: Path, test: str = "") -> StudyFile:
        """Read a study folder's TOML file, or that file; InputError for anything wrong in it.

        Of several tests the one named, or all of them together.
        """
        file = study_file(path)
        settings, name = read_settings(file), file.resolve().parent.name
        if not test and len(settings.tests) != 1:
            return StudyFile(name, file, settings)
        index = next((k for k, one in enumerate(settings.tests) if one.name == test), 0)
        part = StudyPart(index, settings.tests[index], settings.several) if settings.tests else None
        own = settings.of_test(test or settings.tests[0].name)
        return StudyFile(f"{name}.{test}" if settings.several else name, file, own, part=part)

    @property
    def test(self) -> str:
        """Name of the test, where it is one of several."""
        return self.part.settings.name if self.part is not None and self.part.several else ""

    @property
    def condition(self) -> dict[str, float]:
        """Parameter values of this test only, each in its own unit."""
        return {} if self.part is None else dict(self.part.settings.set)

    @property
    def parts(self) -> tuple[StudyFile, ...]:
        """Every test by itself; a study with one test is its only part."""
        if not self.settings.several:
            return (self,)
        return tuple(StudyFile.read(self.file, test.name) for test in self.settings.tests)

    @property
    def synthetic(self) -> bool:
        """Whether the measurement, or some of it, is synthetic."""
        measured = self.settings.tests or (self.settings.measurement,)
        return any(one.synthetic for one in measured)

    @property
    def folder(self) -> Path:
        """The study's folder, without links; files are relative to it."""
        return self.file.resolve().parent

    def measurement(self) -> Measured:
        """Everything that was measured in one test, as fits weight it; InputError where it cannot be read."""
        found = self.measured_data()
        if not isinstance(found, MeasuredResponses):
            return found
        try:
            return found.prepared(self.settings.measurement.accuracy)
        except InputError as fault:
            place = self.place("measurement", "accuracy")
            raise InputError(fault.problem, place=place, remedy=fault.remedy) from None

    @property
    def measured_sensors(self) -> tuple[Sensor, ...]:
        """Sensors of the measured shapes of all tests of the study."""
        every = StudyFile.read(self.file).parts
        measured = [data for one in every if isinstance(data := one.measured_data(), MeasuredModes)]
        return tuple({sensor.name: sensor for modes in measured for sensor in modes.sensors}.values())

    def measured_data(self) -> Measured:
        """What the files of one test hold; InputError where they cannot be read.

        Files that did not change are read once in a process: every result asks for what it was made from.
        """
        measurement = self.settings.measurement
        files = (*measurement.files, *measurement.shapes, *filter(None, [measurement.sensors, measurement.responses]))
        content = [_digest_of_file(self.folder / file) for file in files]
        key = digest_of(str(self.folder), measurement.model_dump(), content)
        if key not in _READ:
            found = self._read()
            while len(_READ) >= _KEPT:
                del _READ[next(iter(_READ))]
            _READ[key] = found
        return _READ[key]

    def _read(self) -> Measured:
        measurement = self.settings.measurement
        if measurement.responses:
            return read_responses(self.path(measurement.responses, "measurement", "responses"), measurement.pooling)
        files = [self.path(f, "measurement", "files", k) for k, f in enumerate(measurement.files)]
        sensors = self.path(measurement.sensors, "measurement", "sensors") if measurement.sensors else None
        # Readers are imported here: a problem in memory reads no file.
        if measurement.kind == "frf":
            from calib.measurement.files.read_frf import read_frfs

            read = read_frfs(
                files,
                quantity=measurement.quantity,
                unit=measurement.unit,
                sensors=sensors,
                averages=measurement.averages,
                channels=measurement.channels,
                variables=measurement.variables,
                length_unit=measurement.length_unit,
                estimator=measurement.estimator,
                synthetic=measurement.synthetic,
            )
            return replace(self._lines_of(read), accuracy=frf_claim(measurement.accuracy))
        from calib.measurement.files.read import read_modes

        measured = read_modes(
            files,
            shapes=[self.path(f, "measurement", "shapes", k) for k, f in enumerate(measurement.shapes)],
            sensors=sensors,
            repeats=measurement.repeats,
            std_of=measurement.std_of,
            mode_names=measurement.mode_names,
            pooling=measurement.pooling,
            length_unit=measurement.length_unit,
            channels=measurement.channels,
            variables=measurement.variables,
            synthetic=measurement.synthetic,
        )
        measured = corrected(measured, measurement.corrected, self.place("measurement", "corrected"))
        return replace(measured, accuracy=Accuracy.of(measurement.accuracy))

    def _lines_of(self, frfs: MeasuredFRFs) -> MeasuredFRFs:
        """The lines of FRFs that the study uses."""
        measurement, key = self.settings.measurement, "band"
        try:
            if measurement.band is not None:
                frfs = frfs.in_band(*measurement.band)
            key = "lines"
            return frfs.lines_near_resonances() if measurement.lines == "resonances" else frfs
        except InputError as fault:
            raise InputError(fault.problem, place=self.place("measurement", key), remedy=fault.remedy) from None

    def place(self, *keys: int | str, mark: Mark = "value") -> Place:
        """Place of a key or of its value in the file, of one test in the table of that test."""
        layers = read_layers(self.file)
        if self.part is None:
            return place_of(layers, *keys, mark=mark)
        own = keys[1:] if keys[:1] == ("measurement",) else keys
        there, exact = find(layers, ("tests", self.part.index, *own), mark)
        elsewhere, common = find(layers, keys, mark)
        of_test = keys[0] == "measurement" or keys[0] in TestSettings.model_fields
        return there if exact or (of_test and not common) else elsewhere

    def path(self, name: str, *keys: int | str) -> Path:
        """A file that the study names under a key; InputError where it is not there."""
        path = self.folder / name
        if not path.is_file():
            raise InputError(
                f"there is no file {name!r}", place=self.place(*keys), remedy="paths are relative to the study's folder"
            )
        return path

    @property
    def inputs(self) -> tuple[Path, ...]:
        """Every file that the study reads, itself included, without links."""
        return (*(layer.file.resolve() for layer in read_layers(self.file)), *self.named_files.values())

    @property
    def named_files(self) -> Mapping[str, Path]:
        """Every file that the study names, by the path as written; links resolved."""
        settings, folder = self.settings, self.folder
        code = [where for f in settings.functions if (where := f.rpartition(":")[0]).endswith(".py")]
        files = list(code)
        for data in settings.tests or (settings.measurement,):
            files += [*data.files, *data.shapes, *filter(None, [data.sensors, data.responses])]
        files += [*settings.model_files, *filter(None, [settings.calibration.start_file])]
        return {file: (folder / file).resolve() for file in files}

    @property
    def code_files(self) -> list[Path]:
        """All code in the study's folder, and in the folders of code files that it names elsewhere."""
        settings, folder = self.settings, self.folder
        files = code_files(folder)
        for named in settings.functions:
            path = (folder / named.rpartition(":")[0]).resolve()
            if path.suffix == ".py" and not path.is_relative_to(folder):
                files += sorted(path.parent.glob("*.py"))
        return files

    @property
    def file_digests(self) -> Mapping[str, str]:
        """Digests of the named files and of all code as they are now; a missing file has none.

        Keys are the path as written in the study for named files, else the path relative to its folder.
        """
        folder, named = self.folder, self.named_files
        others = {Path(os.path.relpath(p, folder)).as_posix(): p for p in self.code_files if p not in named.values()}
        found = ((name, _digest_of_file(path)) for name, path in {**named, **others}.items())
        return {name: digest for name, digest in found if digest}


def _digest_of_file(path: Path) -> str:
    """Digest of a file's content; empty where it cannot be read."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()[:16]
    except OSError:
        return ""


def study_file(path: str | Path) -> Path:
    """The TOML file of a study, given its folder or that file."""
    own = Path(path)
    return own if own.suffix == ".toml" else own / "study.toml"


def shell_argument(path: Path) -> str:
    """A path as a shell argument, quoted where needed; a study's file is given by its folder."""
    return shlex.quote(str(path.parent if path.name == "study.toml" else path))
