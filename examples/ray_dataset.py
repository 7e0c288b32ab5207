"""How do I make a data set on many machines?

    python examples/ray_dataset.py --out out/ray --worlds 64 --worlds-per-task 4 -- \\
        --scene forest --drone cf2x_L250 --seconds 4 --camera fpv --size 64x64

What follows `--` are options of `propwash fly`. Ray (`pip install 'propwash[ray]'`) flies the worlds on all machines of the
cluster that `--address` names, or on this one; the files come back through Ray, no shared disk is needed. The folder holds, byte
for byte, what `propwash fly` writes on one machine. Stopped and started again, it flies only the worlds that are missing.

Every machine needs the program `propwash` of one version and the files that the options name, at the same paths.
"""

from __future__ import annotations

import argparse
import fcntl
import hashlib
import io
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import ray

TYPES = {"float64": pa.float64(), "int64": pa.int64(), "int32": pa.int32(), "bool": pa.bool_()}
OURS = ("--worlds", "--out", "--threads", "--json")
"""Options of `propwash fly` that are set here."""


def fly(program: str, options: list[str], worlds: int, out: Path, cwd: str, threads: int | None = None) -> dict[str, Any]:
    """`propwash fly`: makes the worlds that `out` lacks and seals the data set. Returns its summary."""
    command = [program, "fly", *options, "--worlds", str(worlds), "--out", str(out), "--json"]
    if threads is not None:
        command += ["--threads", str(threads)]
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)}: exit code {done.returncode}\n{done.stderr.strip()}")
    return dict(json.loads(done.stdout))


def world_name(world: int) -> str:
    """The folder of a world."""
    return f"world_{world:05d}"


def write_empty_files(folder: Path, manifest: dict[str, Any]) -> list[dict[str, Any]]:
    """Files of a world without a single row or frame, and their entries in world.json."""
    for name, columns in manifest["tables"].items():
        schema = pa.schema([pa.field(c["name"], TYPES[c["dtype"]], nullable=c["nullable"]) for c in columns])
        pq.write_table(schema.empty_table(), folder / name)
    if manifest["frames"]:
        camera = manifest["cameras"][0]
        sizes = {"frame": 0, "drone": manifest["n_drones"], "row": camera["height"], "column": camera["width"]}
        sizes["obstacle"] = len(manifest.get("obstacles", []))
        arrays = {}
        for a in manifest["frames"]:
            axes = [axis.strip() for axis in a["shape"].strip("()").split(",") if axis.strip()]
            arrays[a["name"]] = np.zeros([sizes[x] if x in sizes else int(x) for x in axes], a["dtype"])
        np.savez(folder / "frames.npz", allow_pickle=False, **arrays)
    entries = []
    for path in sorted(folder.iterdir()):
        data = path.read_bytes()
        entries.append({"path": path.name, "bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()})
    return entries


def fly_some(program: str, options: list[str], manifest_text: str, worlds: list[int], cwd: str, threads: int) -> bytes:
    """Flies some worlds of a data set and returns their folders as tar.

    `propwash fly` makes the worlds that a folder lacks. The worlds of other tasks are therefore put there as worlds that ended
    before their first row, and thrown away afterwards.
    """
    manifest = json.loads(manifest_text)
    n = manifest["n_worlds"]
    with tempfile.TemporaryDirectory(prefix="propwash_") as temporary:
        out, template = Path(temporary, "out"), Path(temporary, "empty")
        out.mkdir()
        template.mkdir()
        (out / "manifest.json").write_text(manifest_text, encoding="utf-8")
        entries = write_empty_files(template, manifest)
        record: dict[str, Any] = dict.fromkeys(("n_states", "n_contacts", "n_clearances", "n_frames"), 0)
        record["quarantine"] = {"step": 0, "drone": 0, "reason": "this world is made by another task"}
        record |= {"info": None, "files": entries}
        for world in set(range(n)) - set(worlds):
            folder = out / world_name(world)
            folder.mkdir()
            for entry in entries:
                os.link(template / entry["path"], folder / entry["path"])
            (folder / "world.json").write_text(json.dumps({"world": world, **record}))
        summary = fly(program, options, n, out, cwd, threads)
        if summary["resumed_worlds"] != n - len(worlds):
            raise RuntimeError(f"expected to fly {len(worlds)} of {n} worlds, flew {n - summary['resumed_worlds']}")
        return pack(out, worlds)


def fly_first(program: str, options: list[str], cwd: str, threads: int) -> tuple[str, bytes]:
    """Flies world 0. Returns the manifest of that flight and the world's folder as tar."""
    with tempfile.TemporaryDirectory(prefix="propwash_") as temporary:
        out = Path(temporary, "out")
        fly(program, options, 1, out, cwd, threads)
        return (out / "manifest.json").read_text(encoding="utf-8"), pack(out, [0])


def pack(out: Path, worlds: list[int]) -> bytes:
    """Folders of worlds as tar."""
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as tar:
        for world in worlds:
            tar.add(out / world_name(world), world_name(world))
    return buffer.getvalue()


def unpack(out: Path, packed: bytes, worlds: list[int]) -> None:
    """Puts worlds into the data set, each whole or not at all."""
    with tempfile.TemporaryDirectory(prefix=".partial_ray_", dir=out) as temporary:
        with tarfile.open(fileobj=io.BytesIO(packed)) as tar:
            tar.extractall(temporary, filter="data")
        for world in worlds:
            os.rename(Path(temporary, world_name(world)), out / world_name(world))


def manifest_for(text: str, worlds: int) -> str:
    """The manifest of a flight of one world as that of a flight of `worlds`: they differ in this number alone."""
    # Once for the data set, once in the description of the flight.
    changed, n = re.subn(r'^( +"n_worlds": )1,$', rf"\g<1>{worlds},", text, flags=re.MULTILINE)
    if n != 2:
        raise RuntimeError("expected two lines \"n_worlds\": 1 in manifest.json; use a version of propwash that fits this example")
    return changed


def check(options: list[str], worlds: int, worlds_per_task: int, threads: int) -> None:
    """Raises ValueError for what cannot be asked for."""
    for option in options:
        if option.split("=")[0] in OURS:
            raise ValueError(f"{option}: is set by this program; leave it out of the options after --")
    for name, n in (("--worlds", worlds), ("--worlds-per-task", worlds_per_task), ("--threads-per-task", threads)):
        if n < 1:
            raise ValueError(f"{name}: expected 1 or more, got {n}")


def make(
    options: list[str], worlds: int, out: Path, worlds_per_task: int = 4, threads: int = 1, program: str = "propwash"
) -> dict[str, Any]:
    """Makes a data set, or what is missing of it, on the machines of Ray.

    Args:
        options: Options of `propwash fly`, without those of `OURS`.
        worlds: Worlds of the whole data set.
        out: Folder of the data set, on the machine that calls this.
        worlds_per_task: Worlds that one machine flies at a time. A task also costs about 2 ms for each world of the whole set, and a picture.
        threads: Threads of a task.
        program: The program `propwash`.

    Returns:
        The summary of `propwash fly`, and `flown_worlds`: how many worlds were flown by this call.
    """
    check(options, worlds, worlds_per_task, threads)
    cwd = os.getcwd()
    out.mkdir(parents=True, exist_ok=True)
    # The lock that `propwash fly` takes too.
    lock = os.open(out, os.O_RDONLY)
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise RuntimeError(f"{out}: another process is writing this data set; wait for it or choose another --out") from None
        flown = fly_missing(options, worlds, out, worlds_per_task, threads, program, cwd)
    finally:
        os.close(lock)
    # Finds all worlds there, compares them with their hashes and writes the seal and the picture.
    return {**fly(program, options, worlds, out, cwd), "flown_worlds": flown}


def fly_missing(
    options: list[str], worlds: int, out: Path, worlds_per_task: int, threads: int, program: str, cwd: str
) -> int:
    """Flies the worlds that `out` lacks. Returns their number."""
    for left_over in out.glob(".partial_*"):
        shutil.rmtree(left_over) if left_over.is_dir() else left_over.unlink()
    found = sorted(p.name for p in out.iterdir())
    path = out / "manifest.json"
    flown = 0
    if not path.exists():
        if found:
            raise RuntimeError(f"{out}: expected an empty folder or a data set, found {found[0]!r} and no manifest.json")
        text, first = ray.get(ray.remote(fly_first).options(num_cpus=threads).remote(program, options, cwd, threads))
        partial = out / ".partial_manifest.json"
        partial.write_text(manifest_for(text, worlds), encoding="utf-8")
        os.rename(partial, path)
        unpack(out, first, [0])
        flown = 1
    text = path.read_text(encoding="utf-8")
    there = json.loads(text)["n_worlds"]
    if there != worlds:
        raise RuntimeError(f"{out}: holds a data set of {there} worlds, asked for {worlds}; choose another --out")

    missing = [w for w in range(worlds) if not (out / world_name(w)).is_dir()]
    parts = [missing[i : i + worlds_per_task] for i in range(0, len(missing), worlds_per_task)]
    task = ray.remote(fly_some).options(num_cpus=threads)
    # Enough to keep all machines busy; more would fill Ray's memory with worlds that wait to be written.
    processors = int(dict(ray.cluster_resources())["CPU"])  # type: ignore[no-untyped-call]
    at_once = max(2, 2 * processors // threads)
    running: dict[Any, list[int]] = {}
    while parts or running:
        while parts and len(running) < at_once:
            part = parts.pop(0)
            running[task.remote(program, options, text, part, cwd, threads)] = part
        (done,), _ = ray.wait(list(running), num_returns=1)
        part = running.pop(done)
        unpack(out, ray.get(done), part)
        flown += len(part)
        left = sum(len(p) for p in [*parts, *running.values()])
        print(f"{worlds - left} of {worlds} worlds", flush=True)
    return flown


def main() -> None:
    arguments = sys.argv[1:]
    split = arguments.index("--") if "--" in arguments else len(arguments)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder of the data set")
    parser.add_argument("--worlds", type=int, required=True, help="worlds of the whole data set")
    parser.add_argument("--worlds-per-task", type=int, default=4, help="worlds that one machine flies at a time")
    parser.add_argument("--threads-per-task", type=int, default=1, help="threads of a task")
    parser.add_argument("--program", default=os.environ.get("PROPWASH_BIN", "propwash"), help="the program propwash")
    parser.add_argument("--address", help="cluster of Ray, e.g. auto; without it one is started on this machine")
    args = parser.parse_args(arguments[:split])
    ray.init(address=args.address, log_to_driver=False)
    summary = make(arguments[split + 1 :], args.worlds, args.out, args.worlds_per_task, args.threads_per_task, args.program)
    print(json.dumps(summary, indent=1))


if __name__ == "__main__":
    main()
