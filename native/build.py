"""Builds the compiled core: `python native/build.py [--strict] [--target TARGET] [--sanitize]`.

With the system's C++ compiler where there is a usable one, else with `ziglang` from the Python
registry, which also builds for other machines (decisions/0680). Nothing is built where the library
is that of these sources, and of its objects only those whose sources or headers are others.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path

ROOM = Path(__file__).resolve().parent
SOURCES = ROOM / "src"
LIBRARY = ROOM / "libtrigpoint_core.so"
SANITIZED = ROOM.parent / "out" / "sanitized" / LIBRARY.name
OBJECTS = ROOM.parent / "out" / "core"
EIGEN = "cmeel-eigen==3.4.1"
ZIG = "ziglang==0.17.1"
# The same results on every machine: no fused multiplications, no instructions of this one alone.
FLAGS = (
    "-std=c++17", "-O3", "-fPIC", "-ffp-contract=off", "-fno-math-errno", "-fvisibility=hidden",
    "-DNDEBUG", "-DEIGEN_MPL2_ONLY", "-DEIGEN_DONT_PARALLELIZE",
)  # fmt: skip
STRICT = ("-Wall", "-Wextra", "-Wshadow", "-Werror")
# What reads or writes beside an array, or has no defined result, ends the program and says where.
SANITIZE = (
    "-O1", "-g1", "-UNDEBUG", "-D_GLIBCXX_ASSERTIONS", "-fno-omit-frame-pointer",
    "-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all",
)  # fmt: skip
_TRIAL = "#include <vector>\nint main() { return std::vector<int>{}.size(); }\n"
_MOST_SECONDS = 900


class BuildError(Exception):
    """The core cannot be built; the message says what to do."""


def built(
    *,
    target: str | None = None,
    strict: bool = False,
    sanitize: bool = False,
    library: Path = LIBRARY,
) -> Path:
    """The library of these sources, built where it is not there yet.

    `target`: another machine as zig names it (`aarch64-linux-gnu.2.28`), this one where it is left
    out; `strict`: warnings are errors; `sanitize`: for a program that loads `sanitizers` first.
    Raises BuildError.
    """
    compiler = _compiler(target)
    flags = [*FLAGS, *(SANITIZE if sanitize else ())]
    digest = _digest([*compiler[-3:], *flags], sorted(_sources(".cpp", ".hpp")))
    if library.exists() and digest.encode() in library.read_bytes():
        return library
    flags += STRICT if strict else ()
    command = [*compiler, *flags, f"-I{SOURCES}", f"-isystem{_eigen()}", "-c"]
    objects = OBJECTS / _digest([*compiler[-3:], *flags, EIGEN], ())[-16:]
    objects.mkdir(parents=True, exist_ok=True)
    sources = sorted(_sources(".cpp"))
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        used = list(pool.map(lambda source: _object(command, source, objects), sources))
    for old in set(objects.glob("*.o")) - set(used):
        old.unlink(missing_ok=True)
    library.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        stamp = Path(folder) / "digest.cpp"
        stamp.write_text(
            'extern "C" __attribute__((visibility("default"))) '
            f'const char tp_digest[] = "{digest}";\n'
        )
        fresh = Path(folder) / library.name
        # The sanitizers' functions are the program's, which has them loaded first; what is carried
        # to other machines leaves its symbols here.
        whole = SANITIZE if sanitize else ("-Wl,-z,defs", *(("-Wl,-s",) if target else ()))
        parts = [*map(str, used), str(stamp), "-o", str(fresh)]
        _run([*compiler, "-shared", "-fPIC", *whole, *parts])
        # A program that has the old one loaded keeps it.
        shutil.copy(fresh, library.with_suffix(".new"))
        library.with_suffix(".new").replace(library)
    return library


def sanitizers() -> list[Path]:
    """What a program must load first (LD_PRELOAD) to use the sanitized library: the sanitizer, and
    what throws, which it looks for as it is loaded. Raises BuildError where there is none."""
    found = []
    for name in ("libasan.so", "libstdc++.so.6"):
        command = [*_compiler(None), f"-print-file-name={name}"]
        named = subprocess.run(
            command, capture_output=True, text=True, timeout=_MOST_SECONDS, check=False
        )
        found.append(Path(named.stdout.strip()))
        if not found[-1].is_absolute():
            raise BuildError(f"no {name}: install g++ (apt-get install g++)")
    return found


def needs() -> list[str]:
    """What must be installed to build here: headers, and a compiler where there is none."""
    return [EIGEN] if _system_compiler() else [EIGEN, ZIG]


def _compiler(target: str | None) -> list[str]:
    """The command of a C++ compiler for that machine."""
    system = None if target else _system_compiler()
    if system:
        return system
    if find_spec("ziglang") is None:
        raise BuildError(
            f"no C++ compiler: install one (apt-get install g++), or `pip install {ZIG}`"
        )
    # By itself zig adds what a debugger needs: 230 MB to a library of 2.
    zig = [sys.executable, "-m", "ziglang", "c++", "-g0"]
    return [*zig, *(["-target", target] if target else [])]


def _system_compiler() -> list[str] | None:
    """The compiler that CXX names, or `c++`, if it builds a program."""
    name = os.environ.get("CXX", "c++")
    if name == "zig" or shutil.which(name) is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        trial = Path(folder) / "trial.cpp"
        trial.write_text(_TRIAL)
        command = [name, "-std=c++17", str(trial), "-o", str(trial.with_suffix(""))]
        works = subprocess.run(command, capture_output=True, timeout=_MOST_SECONDS, check=False)
    return [name] if works.returncode == 0 else None


def _eigen() -> Path:
    """Eigen's headers, of the package `cmeel-eigen`."""
    for place in sys.path:
        headers = Path(place) / "cmeel.prefix" / "include" / "eigen3"
        if headers.is_dir():
            return headers
    raise BuildError(f"Eigen's headers are missing: `pip install {EIGEN}`")


def _sources(*suffixes: str) -> list[Path]:
    return [path for path in SOURCES.rglob("*") if path.suffix in suffixes]


def _digest(command: Sequence[str], sources: Sequence[Path]) -> str:
    """Of sources and of how they are compiled."""
    digest = sha256(" ".join(command).encode())
    for path in sources:
        digest.update(path.relative_to(SOURCES).as_posix().encode() + path.read_bytes())
    return f"trigpoint-core/{digest.hexdigest()}"


def _object(command: list[str], source: Path, folder: Path) -> Path:
    """The object of a source in `folder`, compiled where that has none of it and its headers."""
    digest = _digest([], sorted(_with_headers(source, set())))
    made = folder / f"{source.stem}-{digest[-32:]}.o"
    if not made.exists():
        fresh = made.with_suffix(f".{os.getpid()}")  # somebody else may build it, too
        _run([*command, str(source), "-o", str(fresh)])
        fresh.replace(made)
    return made


def _with_headers(source: Path, known: set[Path]) -> set[Path]:
    """A source and the core's headers that it includes, and those that they include."""
    if source not in known:
        known.add(source)
        for name in re.findall(r'^#include "(.+)"', source.read_text(), re.MULTILINE):
            _with_headers(SOURCES / name, known)
    return known


def _run(command: list[str]) -> None:
    try:
        ran = subprocess.run(
            command, capture_output=True, text=True, timeout=_MOST_SECONDS, check=False
        )
    except subprocess.TimeoutExpired:
        raise BuildError(
            f"the compiler took longer than {_MOST_SECONDS} s; build again once the machine is "
            f"less busy, what is done is kept:\n{' '.join(command)}"
        ) from None
    if ran.returncode:
        raise BuildError(f"the compiler failed:\n{' '.join(command)}\n{ran.stderr[-4000:]}")


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description="Builds the compiled core.")
    parser.add_argument("--strict", action="store_true", help="warnings are errors")
    parser.add_argument("--target", help="another machine, as zig names it")
    parser.add_argument("--sanitize", action="store_true", help="for `make fuzz`")
    parser.add_argument("--out", type=Path, help="the library to write")
    chosen = parser.parse_args()
    library = chosen.out or (SANITIZED if chosen.sanitize else LIBRARY)
    try:
        built(target=chosen.target, strict=chosen.strict, sanitize=chosen.sanitize, library=library)
    except BuildError as error:
        sys.exit(f"build: {error}")


if __name__ == "__main__":
    main()
