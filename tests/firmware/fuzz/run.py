"""Fuzz the core:  run.py SECONDS|--inputs|--few [SEED]   (the targets share it; see build/fuzz).

Starts from the corpus beside this file and what earlier runs have found. An input that breaks a
target is left in build/fuzz and printed; to keep what a long run has learned:
`build/fuzz/TARGET -merge=1 tests/firmware/fuzz/corpus/TARGET build/fuzz/corpus/TARGET`.
"""

import shutil
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
BUILD = HERE.parents[2] / "build" / "fuzz"
# With --inputs so many are tried: as many on a slow machine as on a fast one. An input of the byte
# entry takes 1 to 3 ms, one of the store 0.1 to 0.2 ms.
TARGETS = {"fuzz_bytes": 5_000, "fuzz_store": 20_000}
# With --few: the corpus, a few hundred, and three times as many again or more.
FEW = {"fuzz_bytes": 1_500, "fuzz_store": 5_000}


def build() -> None:
    """Compile the targets; clang is needed for libFuzzer."""
    cmake = shutil.which("cmake", path=str(Path(sys.executable).parent)) or "cmake"
    configure = ["-S", str(HERE), "-B", str(BUILD), "-G", "Ninja", "-DCMAKE_CXX_COMPILER=clang++"]
    for command in ([cmake, *configure], [cmake, "--build", str(BUILD)]):
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


def fuzz(target: str, limit: str, seed: int = 1) -> subprocess.CompletedProcess[str]:
    """Run one target up to a limit of libFuzzer's, `-max_total_time=SECONDS` or `-runs=INPUTS`."""
    found = BUILD / "corpus" / target
    found.mkdir(parents=True, exist_ok=True)
    return subprocess.run(
        [
            str(BUILD / target),
            limit,
            f"-seed={seed}",
            "-verbosity=0",
            "-print_final_stats=1",
            f"-artifact_prefix={BUILD}/{target}-",
            str(found),
            str(HERE / "corpus" / target),
        ],
        capture_output=True,
        text=True,
        check=False,
    )


def main() -> int:
    """Fuzz every target; 1 if one broke."""
    counts = {"--inputs": TARGETS, "--few": FEW}.get(sys.argv[1] if len(sys.argv) > 1 else "")
    seconds = 0 if counts or len(sys.argv) < 2 else int(sys.argv[1])
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    build()
    broken = 0
    for target in TARGETS:
        share_s = (seconds or 60) // len(TARGETS)
        limit = f"-runs={counts[target]}" if counts else f"-max_total_time={share_s}"
        done = fuzz(target, limit, seed)
        print(f"{target}: {'ok' if done.returncode == 0 else 'BROKEN'}\n{done.stderr}")
        broken |= done.returncode != 0
    return int(broken)


if __name__ == "__main__":
    sys.exit(main())
