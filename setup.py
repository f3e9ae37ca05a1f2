"""Builds the compiled kernels of ``torchreg.native``, once for each width of vectors that processors have.

They are optional: where no C++ compiler is at hand the package installs without them, and torch computes the same.
"""

import copy
import importlib.util
import os
import platform
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_ext import build_ext

ROOT = Path(__file__).parent
SOURCES = ROOT / "torchreg" / "native" / "src"


def fingerprint() -> str:
    """Of the sources, as the loader computes it; read from the file so that torch need not be installed."""
    spec = importlib.util.spec_from_file_location("fingerprint", SOURCES.parent / "fingerprint.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.fingerprint(SOURCES)


def levels() -> dict[str, list[str]]:
    """The libraries by name, with the compiler's options for their instructions."""
    if platform.machine().lower() not in ("x86_64", "amd64"):
        return {"kernels_default": []}
    if sys.platform == "win32":
        return {"kernels_default": [], "kernels_avx2": ["/arch:AVX2"], "kernels_avx512": ["/arch:AVX512"]}
    avx2 = ["-mavx2", "-mpopcnt"]
    avx512 = [*avx2, "-mavx512f", "-mavx512bw", "-mavx512vl", "-mavx512dq", "-mprefer-vector-width=512"]
    return {"kernels_default": [], "kernels_avx2": avx2, "kernels_avx512": avx512}


def extension(name: str, instructions: list[str]) -> Extension:
    """One library."""
    if sys.platform == "win32":
        options, links = ["/std:c++17", "/O2", "/fp:precise", "/EHsc"], []
    else:
        options = ["-std=c++17", "-O3", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math"]
        options += ["-fvisibility=hidden", "-pthread", "-g0", "-Wno-maybe-uninitialized"]
        links = ["-pthread"]
    return Extension(
        f"torchreg.native.lib.{name}",
        sources=sorted(str(path.relative_to(ROOT)) for path in SOURCES.glob("*.cpp")),
        depends=sorted(str(path.relative_to(ROOT)) for path in SOURCES.glob("*.hpp")),
        define_macros=[("TORCHREG_SOURCES", f'"{fingerprint()}"')],
        extra_compile_args=[*options, *instructions],
        extra_link_args=links,
        language="c++",
        optional=True,
    )


class BuildLibraries(build_ext):
    """Plain shared libraries, which no version of Python is built into."""

    def run(self) -> None:
        """Build what can be built, and say what follows where something cannot."""
        super().run()
        missing = [
            ext.name for ext in self.extensions if not Path(self.build_lib, self.get_ext_filename(ext.name)).exists()
        ]
        if missing:
            self.warn(
                f"not built: {', '.join(missing)}. Is there a C++17 compiler? Without, torch computes the same, slower."
            )

    def build_extension(self, ext: Extension) -> None:
        """Compile the sources side by side, into a folder of each library: its objects are named as those of others."""
        own = copy.copy(self)
        own.build_temp = str(Path(self.build_temp, ext.name))
        own.compiler = copy.copy(self.compiler)

        def compile_apart(sources: list[str], **options: object) -> list[str]:
            with ThreadPoolExecutor(os.cpu_count()) as pool:
                parts = pool.map(lambda source: self.compiler.compile([source], **options), sources)
                return [path for part in parts for path in part]

        own.compiler.compile = compile_apart
        super(BuildLibraries, own).build_extension(ext)

    def copy_extensions_to_source(self) -> None:
        """Put the libraries beside their sources, in a folder that is not kept with these."""
        (ROOT / "torchreg" / "native" / "lib").mkdir(exist_ok=True)
        super().copy_extensions_to_source()

    def get_ext_filename(self, fullname: str) -> str:
        """The path of a library, by its name alone."""
        return str(Path(*fullname.split(".")).with_suffix(".dll" if sys.platform == "win32" else ".so"))

    def get_export_symbols(self, ext: Extension) -> list[str]:
        """What a library gives out is marked in its sources."""
        return []


class PlatformWheel(bdist_wheel):
    """A wheel for one platform and any Python 3."""

    def get_tag(self) -> tuple[str, str, str]:
        """Without the version of Python."""
        return ("py3", "none", super().get_tag()[2])


setup(
    ext_modules=[extension(*level) for level in levels().items()],
    cmdclass={"build_ext": BuildLibraries, "bdist_wheel": PlatformWheel},
)
