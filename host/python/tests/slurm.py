"""The workflow on Slurm's own daemons, with this machine as the only node: run by `cargo xtask cluster`, as root.

What is checked: the same bytes as on one machine, and after a job was killed, after the controller was killed and started again, after
Snakemake was interrupted, and after the disk of the results was full: the rest finishes, nothing is computed twice, nothing is lost.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import pathlib
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Generator

WORKFLOW = pathlib.Path(__file__).parents[1] / "workflow"
CONFIGURATION = pathlib.Path("/etc/slurm/slurm.conf")
# Begins the configuration that is written here. One that begins otherwise belongs to a cluster.
MARK = "# Written by cargo xtask cluster; removed when it ends.\n"
RESULTS = ("records.jsonl", "population.json", "prior.toml")
SESSIONS = 6
CORES = 2
# Jobs take as long at least, so that something can be done in the middle of one.
JOB_S = 4
LATEST_S = 900.0
# Without an accounting database. A query that fails is repeated at the next one, and not five times with a pause of minutes.
UNACCOUNTED = ("--slurm-status-command", "squeue", "--slurm-status-attempts", "1", "--slurm-init-seconds-before-status-checks", "10")
PLAN = """\
[needle]
youngs_modulus_gpa = 200.0
outer_diameter_mm = 1.27
inner_diameter_mm = 1.0
[rig]
guide2_mm = 60.0
entry_mm = 70.0
[noise]
force_n = 0.02
displacement_mm = 0.01
shape_mm = 0.025
[tissue]
k_kpa = {k_kpa}
[[lateral]]
id = "y20-1"
depth_mm = 20
[[lateral]]
id = "y40-1"
depth_mm = 40
"""


def wait(what: str, is_there: Callable[[], bool], latest_s: float = LATEST_S) -> None:
    """Waits until something is the case."""
    end = time.monotonic() + latest_s
    while not is_there():
        if time.monotonic() > end:
            raise SystemExit(f"{what}: not within {latest_s:.0f} s")
        time.sleep(0.1)


def output(*command: object) -> str:
    """What a command prints; nothing where it fails."""
    return subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False).stdout


def check(is_so: bool, what: str) -> None:
    """Ends the program where something is not so."""
    if not is_so:
        raise SystemExit(f"failed: {what}")


class Node:
    """Munge's daemon, Slurm's controller and Slurm's daemon of the node, started here and ended here."""

    def __init__(self, folder: pathlib.Path) -> None:
        self.folder = folder
        self.processes: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, name: str, *command: object) -> None:
        """Starts a daemon in the foreground, its output in a file."""
        with (self.folder / f"{name}.out").open("ab") as log:
            self.processes[name] = subprocess.Popen([str(word) for word in command], stdout=log, stderr=log)

    def controller(self) -> None:
        """Starts the controller and waits until it answers."""
        self.start("slurmctld", "slurmctld", "-D")
        wait("slurmctld", lambda: "UP" in output("scontrol", "ping"), 60.0)

    def end(self, name: str, how: signal.Signals = signal.SIGTERM) -> None:
        """Ends a daemon."""
        process = self.processes.pop(name)
        process.send_signal(how)
        process.wait()

    def configure(self) -> None:
        """Writes Slurm's configuration. Jobs do not inherit another path of it."""
        if CONFIGURATION.exists() and not CONFIGURATION.read_text(encoding="utf-8").startswith(MARK):
            raise SystemExit(f"{CONFIGURATION}: is there already, expected a machine without a Slurm of its own")
        host = socket.gethostname()
        memory_mb = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 2_000_000
        text = f"""{MARK}ClusterName=needle
SlurmctldHost={host}(127.0.0.1)
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
StateSaveLocation={self.folder}/state
SlurmdSpoolDir={self.folder}/spool
SlurmctldPidFile={self.folder}/slurmctld.pid
SlurmdPidFile={self.folder}/slurmd.pid
ProctrackType=proctrack/pgid
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
ReturnToService=2
MpiDefault=none
NodeName={host} NodeAddr=127.0.0.1 CPUs={CORES} RealMemory={memory_mb} State=UNKNOWN
PartitionName=all Nodes=ALL Default=YES MaxTime=INFINITE State=UP
"""
        CONFIGURATION.parent.mkdir(parents=True, exist_ok=True)
        CONFIGURATION.write_text(text, encoding="utf-8")

    def __enter__(self) -> Node:
        for name in ("state", "spool"):
            (self.folder / name).mkdir(parents=True, exist_ok=True)
        self.configure()
        if "Success" not in subprocess.run("munge -n | unmunge", shell=True, capture_output=True, text=True, check=False).stdout:
            for name in ("/run/munge", "/var/log/munge", "/var/lib/munge"):
                pathlib.Path(name).mkdir(parents=True, exist_ok=True)
                shutil.chown(name, "munge", "munge")
            self.start("munged", "setpriv", "--reuid=munge", "--regid=munge", "--clear-groups", "/usr/sbin/munged", "--foreground")
            wait("munged", lambda: "Success" in output("sh", "-c", "munge -n | unmunge"), 60.0)
        self.controller()
        self.start("slurmd", "slurmd", "-D")
        wait("node", lambda: output("sinfo", "-h", "-o", "%T").strip() == "idle", 60.0)
        return self

    def __exit__(self, *_: object) -> None:
        output("scancel", "--user", "root", "--full")
        for name in reversed(list(self.processes)):
            self.end(name)
        CONFIGURATION.unlink(missing_ok=True)


class Trial:
    """A run of the workflow in a folder of its own, with a log of what `guide summarize` has begun and ended."""

    runs: list[subprocess.Popen[bytes]] = []
    """Of all trials, so that none outlives the program."""

    def __init__(self, base: pathlib.Path, name: str) -> None:
        self.folder = base / name
        self.out = self.folder / "population"
        self.out.mkdir(parents=True)
        self.log = self.folder / "guide.log"
        program = self.folder / "bin" / "guide"
        program.parent.mkdir()
        real = pathlib.Path(sys.executable).with_name("guide")
        log = f'"${{SLURM_JOB_ID:-0}} $*" >> {self.log}'
        lines = ["#!/bin/sh", f"echo begin {log}", f"sleep {JOB_S}", f'{real} "$@"', "code=$?", f"echo end-$code {log}", "exit $code"]
        program.write_text("\n".join(lines) + "\n", encoding="utf-8")
        program.chmod(0o755)
        self.sessions = base / "sessions"

    def start(self, *options: str) -> subprocess.Popen[bytes]:
        """Starts Snakemake; batches of one session."""
        command = [sys.executable, "-m", "snakemake", "--snakefile", str(WORKFLOW / "Snakefile"), *options]
        command += ["--config", f"sessions={self.sessions}", "batch=1"]
        folders = [str(self.folder / "bin"), str(pathlib.Path(sys.executable).parent), os.environ["PATH"]]
        with (self.folder / "snakemake.out").open("ab") as log:
            environment = {**os.environ, "PATH": ":".join(folders)}
            process = subprocess.Popen(command, cwd=self.folder, stdout=log, stderr=log, env=environment)
        self.runs.append(process)
        return process

    def slurm(self, *options: str) -> subprocess.Popen[bytes]:
        """Starts Snakemake with the profile of Slurm; there is no accounting database."""
        return self.start("--profile", str(WORKFLOW / "profiles" / "slurm"), *UNACCOUNTED, *options)

    def batches(self, word: str) -> list[tuple[str, str]]:
        """Batches that were begun (`begin`) or ended with a code (`end-0`), and their jobs."""
        lines = self.log.read_text(encoding="utf-8").splitlines() if self.log.exists() else []
        found = [line.split() for line in lines]
        return [(words[words.index("--out") + 1], words[1]) for words in found if words[0] == word and words[2] == "summarize"]

    def counts(self, word: str) -> Counter[str]:
        """How often each batch was begun or ended with a code."""
        return Counter(batch for batch, _ in self.batches(word))

    def under_way(self) -> list[str]:
        """Jobs whose batch is being computed, once another has been completed and one has just begun: it is the last."""
        ended = self.counts("end-0")
        if not self.log.exists() or not self.log.read_text(encoding="utf-8").splitlines()[-1].startswith("begin"):
            return []
        return [job for batch, job in self.batches("begin") if batch not in ended] if ended else []

    def compare(self, reference: Trial, again: int = 0) -> None:
        """Checks that results are the same bytes as those of another trial, and that at most so many batches were completed twice."""
        for name in RESULTS:
            check((self.out / name).read_bytes() == (reference.out / name).read_bytes(), f"{self.folder.name}: {name} differs")
        ended = self.counts("end-0")
        is_so = len(ended) == SESSIONS + 1 and max(ended.values()) <= 2 and sum(ended.values()) <= SESSIONS + 1 + again
        check(is_so, f"{self.folder.name}: batches were completed {ended}")

    def repeated(self) -> int:
        """Batches that were begun more than once."""
        return sum(number > 1 for number in self.counts("begin").values())


def make_sessions(base: pathlib.Path) -> None:
    """Simulated sessions, and one that fails."""
    guide = pathlib.Path(sys.executable).with_name("guide")
    for number in range(1, SESSIONS + 1):
        plan = base / "plan.toml"
        plan.write_text(PLAN.format(k_kpa=8.0 + 0.7 * number), encoding="utf-8")
        folder = base / "sessions" / f"s{number:02}"
        subprocess.run([guide, "simulate", "--config", plan, "--out", folder, "--seed", str(number)], check=True, stdout=subprocess.DEVNULL)
    broken = base / "sessions" / "broken"
    broken.mkdir()
    (broken / "session.toml").write_text("[session]\n", encoding="utf-8")


@contextlib.contextmanager
def small_disk(folder: pathlib.Path) -> Generator[None, None, None]:
    """A file system in memory of 4 MB."""
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=4m", "tmpfs", folder], check=True)
    try:
        yield
    finally:
        subprocess.run(["umount", "--lazy", folder], check=True)


def exit_code(trial: Trial, process: subprocess.Popen[bytes]) -> int:
    """Waits for the end of a run."""
    wait(f"{trial.folder.name}: end of Snakemake", lambda: process.poll() is not None)
    return process.wait()


def timed(trial: Trial, process: subprocess.Popen[bytes]) -> float:
    """Seconds until a run has ended well."""
    begun = time.monotonic()
    check(exit_code(trial, process) == 0, f"{trial.folder.name}: Snakemake failed, see {trial.folder / 'snakemake.out'}")
    return time.monotonic() - begun


def job_killed(trial: Trial) -> str:
    """One job is cancelled while it computes; the profile repeats it."""
    process = trial.slurm()
    wait("a batch under way", lambda: bool(trial.under_way()))
    output("scancel", trial.under_way()[-1])
    timed(trial, process)
    check(trial.repeated() == 1, f"{trial.repeated()} batches were begun again, expected the killed one")
    return "the killed batch was repeated in the same run"


def controller_killed(node: Node, trial: Trial) -> str:
    """The controller is killed and comes back."""
    process = trial.slurm()
    wait("a batch under way", lambda: bool(trial.under_way()))
    node.end("slurmctld", signal.SIGKILL)
    time.sleep(10.0)
    node.controller()
    timed(trial, process)
    check(trial.repeated() == 0, f"{trial.repeated()} batches were begun again")
    return "no batch was repeated"


def interrupted(trial: Trial) -> str:
    """Ctrl-C in Snakemake, which cancels its jobs; then the same command again."""
    process = trial.slurm()
    wait("a batch under way", lambda: bool(trial.under_way()))
    process.send_signal(signal.SIGINT)
    check(exit_code(trial, process) != 0, "interrupted: Snakemake ended as if nothing had happened")
    wait("no job", lambda: not output("squeue", "-h").strip(), 60.0)
    before = sum(trial.counts("end-0").values())
    check(0 < before <= SESSIONS, f"interrupted: {before} batches were completed before")
    timed(trial, trial.slurm())
    # Also batches whose end Snakemake had not noticed: it takes their files for incomplete.
    return f"{before} batches were completed before; {trial.repeated()} of all were begun a second time"


def disk_full(trial: Trial, reference: Trial) -> str:
    """The disk of the results is full but for a few records; then there is room again."""
    filler = trial.out / "filler"
    # Room for four records of 14 kB.
    filler.write_bytes(bytes(4 * 2**20 - 60_000))
    process = trial.slurm("--retries", "0")
    check(exit_code(trial, process) != 0, "full disk: Snakemake ended as if nothing had happened")
    whole = {path.name: path.read_bytes() for path in (reference.out / "batches").iterdir()}
    written = {path.name: path.read_bytes() for path in (trial.out / "batches").glob("*.jsonl")}
    check(all(whole[name] == text for name, text in written.items()), "full disk: a batch was written in part")
    failed = sum(trial.counts("end-1").values())
    check(failed > 0, "full disk: no batch has failed")
    filler.unlink()
    timed(trial, trial.slurm())
    return f"{len(written)} batches were written whole, {failed} failed; the second run computed these"


def main() -> None:
    """Runs everything and prints a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=pathlib.Path, help="folder for sessions, results and logs; removed first")
    base = parser.parse_args().folder.resolve()
    # As on a terminal, also where a shell has started this in the background; and the daemons are ended in any case.
    for one in (signal.SIGINT, signal.SIGTERM):
        signal.signal(one, signal.default_int_handler)
    shutil.rmtree(base, ignore_errors=True)
    base.mkdir(parents=True)
    make_sessions(base)
    local = Trial(base, "local")
    local_s = timed(local, local.start("--cores", str(CORES)))
    print(f"{SESSIONS} sessions and one that fails, a batch each\n\n| run | result |\n|---|---|", flush=True)
    print(f"| `--cores {CORES}` | {local_s:.0f} s |", flush=True)
    with Node(base) as node:
        clean = Trial(base, "slurm")
        slurm_s = timed(clean, clean.slurm())
        clean.compare(local)
        more_s = (slurm_s - local_s) / (SESSIONS + 1)
        print(f"| Slurm, one node of {CORES} cores | {slurm_s:.0f} s, {more_s:.1f} s more per job; same bytes |", flush=True)
        cases: list[tuple[str, Callable[[Trial], str]]] = [
            ("a job is killed", job_killed),
            ("the controller is killed, and started again after 10 s", lambda trial: controller_killed(node, trial)),
            ("Ctrl-C in Snakemake, then the same command again", interrupted),
        ]
        for number, (what, case) in enumerate(cases):
            trial = Trial(base, f"case{number}")
            found = case(trial)
            trial.compare(local, SESSIONS if case is interrupted else 0)
            print(f"| {what} | {found}; same bytes |", flush=True)
        trial = Trial(base, "full")
        with small_disk(trial.out):
            found = disk_full(trial, local)
            trial.compare(local)
        print(f"| disk of the results is full, then has room again | {found}; same bytes |", flush=True)


if __name__ == "__main__":
    try:
        main()
    finally:
        for run in Trial.runs:
            run.kill()
