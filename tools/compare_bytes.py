"""Whether the working tree still writes the bytes that a commit before it writes, over all renderers, in one run.

python tools/compare_bytes.py [BASE] [--quick] [--only NAME] [--keep FOLDER [--again]]

BASE is a commit; without it, where the branch left main. Both trees run the same commands of `unisim`, each with its own code and
native library, one thread each, beside each other: instruction sets, qualities, torch and the compiled kernels, trained and
untrained renderers, edits, processes, error bounds, and trainings with a fixed seed. All files are compared, less seconds and
digests of the code. Where files differ their numbers are compared, and the exit status is 1. All cases take 35 minutes with two
cores that other programs share, two of them for building another native library; no case may take longer than 30.

`tools/intended_differences.json` lists differences that are meant: the commit that made them, the reason, and patterns of a case,
of a file and of a part of it (a channel, an array, a place in a JSON file, as this tool prints them; "*" for all). They hold
where BASE is from before that commit. `docs/measurements/same-bytes.md` says how much each one changes.
"""

from __future__ import annotations

import shutil
import signal
import sys
import tempfile
import time
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

import click

sys.path.insert(0, str(Path(__file__).parent))

from byte_checks.cases import CASES, Case, chosen
from byte_checks.difference import NOT_COMPARED, Difference, Intended, differences, files_of, read_intended
from byte_checks.inputs import write_inputs
from byte_checks.trees import Tree, TreeError, default_base, git, in_force, instruction_set, worktree

ROOT = Path(__file__).resolve().parents[1]
INTENDED = Path(__file__).with_name("intended_differences.json")
NAMES = ("base", "head")
WIDTH = max(map(len, CASES))


class Comparison:
    """Cases run in two trees, and what differs. ``inputs`` is the folder of scenarios; what the base makes that later cases read
    is copied to ``made``. With ``again`` nothing is run: the trees' cases are written already."""

    def __init__(
        self, base: Tree, head: Tree, inputs: Path, made: Path, intended: list[Intended], again: bool = False
    ) -> None:
        self.base, self.head, self.inputs, self.made, self.intended, self.again = (
            base,
            head,
            inputs,
            made,
            intended,
            again,
        )
        self.used: dict[Intended, int] = defaultdict(int)
        self.meant: dict[str, set[str]] = defaultdict(set)
        """By cases, the commits that they differ by."""
        self.failed: list[str] = []
        self.identical = self.skipped = 0
        self.without: set[str] = set()
        """Cases that wrote no files."""

    def run(self, case: Case) -> None:
        """Run a case in both trees, and print its row."""
        if lacking := [name for name in (*case.after, case.same_as) if name in self.without]:
            return self._row(case, 0, f"not run: {lacking[0]} has no files", failed=lacking[0] in self.failed)
        before, after = (tree.out / case.name for tree in (self.base, self.head))
        if not self.again:
            with ThreadPoolExecutor(2) as pool:
                faults = list(pool.map(lambda tree: tree.run(case, self.inputs, self.made), (self.base, self.head)))
            if any(faults):
                for folder in (before, after):  # what is half written is not to be judged again
                    shutil.rmtree(folder)
                return self._row(case, 0, "; ".join(filter(None, faults)), failed=True)
            if any(case.name in other.after for other in CASES.values()):
                shutil.copytree(before, self.made / case.name, ignore=shutil.ignore_patterns(*NOT_COMPARED))
        if case.instruction_set and (here := instruction_set(before)) != case.instruction_set:
            return self._row(case, 0, f"not run: this machine has {here}")
        files = files_of(before)
        if not files:
            return self._row(case, 0, "wrote no file", failed=True)
        found = {"": self._unmeant(case, differences(before, after))}
        for tree in (self.base, self.head) if case.same_as else ():
            # a difference between two commits may be meant, one between two numbers of processes never is
            found[f"{tree.name}, beside {case.same_as}: "] = differences(tree.out / case.same_as, tree.out / case.name)
        for words, some in found.items():
            if some:
                more = f" ({len(some) - 1} files more differ)" if len(some) > 1 else ""
                return self._row(case, len(files), f"{words}{some[0]}{more}", failed=True)
        if commits := self.meant[case.name]:
            return self._row(case, len(files), f"as intended by {', '.join(sorted(commits))}")
        self.identical += 1
        return self._row(case, len(files), "identical")

    def _unmeant(self, case: Case, found: list[Difference]) -> list[Difference]:
        left = []
        for difference in found:
            parts = []
            for part in difference.parts:
                covering = [row for row in self.intended if row.covers(case.name, difference.file, part.name)]
                for row in covering:
                    self.used[row] += 1
                    self.meant[case.name].add(row.commit)
                if not covering:
                    parts.append(part)
            if parts:
                left.append(Difference(difference.file, tuple(parts)))
        return left

    def summary(self) -> list[str]:
        """Lines: how many cases there are of each kind, and what the intended differences are."""
        meant = sorted(case for case, commits in self.meant.items() if commits and case not in self.failed)
        counts = (
            f"{self.identical} identical, {len(meant)} as intended, {len(self.failed)} failed, {self.skipped} not run"
        )
        reasons = {row.commit: row.reason for row in self.used}
        return ["", *(f"{commit}: {reason}" for commit, reason in reasons.items()), counts]

    def _row(self, case: Case, files: int, result: str, failed: bool = False) -> None:
        if failed:
            self.failed.append(case.name)
        elif not files:
            self.skipped += 1
        if not files:
            self.without.add(case.name)
        click.echo(f"{case.name:{WIDTH}}  {files:5}  {result}")


@click.command()
@click.argument("base", required=False)
@click.option(
    "--only", multiple=True, metavar="NAME", help="Cases whose names contain this, and those that they read from."
)
@click.option("--quick", is_flag=True, help="A few cases: a look, in less than a minute.")
@click.option("--keep", type=click.Path(path_type=Path), help="An empty folder for everything that is written, kept.")
@click.option(
    "--again", is_flag=True, help="Run nothing: judge what an earlier run of the same commits left in --keep."
)
@click.option("--list", "listed", is_flag=True, help="Print the names of the cases alone.")
def main(base: str | None, only: tuple[str, ...], quick: bool, keep: Path | None, again: bool, listed: bool) -> None:
    """Compare the working tree's bytes with those of the commit BASE, in about half an hour."""
    try:
        cases = chosen(only, quick)
    except KeyError as fault:
        raise click.BadParameter(f"{fault.args[0]!r}: no case's name contains it; see --list") from None
    if listed:
        click.echo("\n".join(case.name for case in cases))
        return
    if again and (keep is None or not all((keep / name).is_dir() for name in NAMES)):
        raise click.BadParameter("--again needs --keep FOLDER with what an earlier run wrote")
    if not again and keep is not None and keep.exists() and any(keep.iterdir()):
        raise click.BadParameter(f"{keep}: is not empty")
    begun = time.monotonic()
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))  # the worktree goes in this case, too
    try:
        with ExitStack() as stack:
            folder = keep or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="compare-bytes-")))
            done = _compare(base or default_base(ROOT), cases, folder.resolve(), stack, again)
    except (TreeError, OSError, ValueError) as fault:
        raise click.ClickException(str(fault)) from None
    for words in done.summary():
        click.echo(words)
    click.echo(f"{len(cases)} cases in {time.monotonic() - begun:.0f} s")
    sys.exit(bool(done.failed))


def _compare(commit: str, cases: list[Case], folder: Path, stack: ExitStack, again: bool) -> Comparison:
    """Run cases in both trees, or judge what they wrote ``again``."""
    commit = git(ROOT, "rev-parse", "--verify", f"{commit}^{{commit}}")
    intended = in_force(read_intended(INTENDED), ROOT, commit)
    inputs, made = folder / "inputs", folder / "made"
    base, head = (Tree(name, root, folder / name) for name, root in zip(NAMES, (folder / "tree", ROOT), strict=True))
    if not again:
        stack.enter_context(worktree(ROOT, commit, base.root))
        for tree in (base, head):
            tree.out.mkdir(parents=True)
            tree.check()
        write_inputs(inputs, base.root / "sample" / "scene", made / "synth" / "log")
    click.echo(f"base: {git(ROOT, 'log', '-1', '--format=%h %s', commit)}\n")
    click.echo(f"{'case':{WIDTH}}  files  result")
    comparison = Comparison(base, head, inputs, made, intended, again)
    for case in cases:
        comparison.run(case)
    if len(cases) == len(CASES):
        for row in intended:
            if row not in comparison.used:
                click.echo(
                    f"note: no case had the difference {row.case}, {row.file}, {row.part} of {row.commit}: {row.reason}"
                )
    return comparison


if __name__ == "__main__":
    main()
