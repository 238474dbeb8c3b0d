"""`./run` on machines that are not this one: every command that it calls is a stand-in that keeps a log."""

from __future__ import annotations

import re
import shutil
import subprocess
import tomllib
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from packaging.requirements import Requirement

CHECKOUT = Path(__file__).resolve().parent.parent
LOCKS = CHECKOUT / ".lock"
REAL_TOOLS = [
    "sh",
    "cat",
    "grep",
    "sha256sum",
    "find",
    "sort",
    "cp",
    "rm",
    "mkdir",
    "dirname",
    "env",
    "ls",
    "printf",
]

PYTHON = r"""#!/bin/sh
echo "python $*" >>"$LOG"
case "$*" in
    *%d.%d*) echo "${VERSION:-3.11}" ;;
    *"sys.version_info >= (3, 14)"*) [ "${VERSION:-3.11}" != 3.14 ] ;;
    *Python.h*) [ -z "${NO_HEADERS:-}" ] ;;
    *"sys.exit(sys.version_info <"*) [ "${VERSION:-3.11}" != 3.9 ] ;;
    *"import venv, ensurepip"* | "-m ensurepip") [ -z "${NO_ENSUREPIP:-}" ] ;;
    *"import venv, pip"*) [ -n "${HAS_PIP:-}" ] ;;
    -) [ -z "${NO_GL:-}" ] ;;
    "-m venv "*)
        for folder; do :; done
        mkdir -p "$folder/bin"
        for name in python pytest phoslab; do cp "$0" "$folder/bin/$name"; done
        ;;
    *" install "*"--require-hashes"*)
        echo "HOME=$HOME PYTHONPATH=${PYTHONPATH:-}" >>"$LOG"
        [ -z "${PIP_SAYS:-}" ] || { echo "$PIP_SAYS" >&2; exit 1; }
        ;;
    *" wheel "*)
        for copy; do :; done
        (cd "$copy" && find . -type f) >>"$LOG"
        mkdir "$copy/wheel" && : >"$copy/wheel/phoslab.whl"
        ;;
esac
"""
LOGGED = '#!/bin/sh\necho "$(basename "$0") $*" >>"$LOG"\n'
SUDO = '#!/bin/sh\necho "sudo $*" >>"$LOG"\n[ "$1" != -n ] || shift\nexec "$@"\n'


@dataclass
class Machine:
    """A checkout in a folder with a space in its name, on a machine of which the test says what it has."""

    checkout: Path
    tools: Path
    log: Path
    env: dict[str, str] = field(default_factory=dict)

    def has(self, name: str, script: str) -> None:
        path = self.tools / name
        path.unlink(missing_ok=True)
        path.write_text(script)
        path.chmod(0o755)

    def run(self, *arguments: str, answer: str = "") -> subprocess.CompletedProcess[str]:
        self.log.write_text("")
        return subprocess.run(
            [self.checkout / "run", *arguments],
            env=self.env,
            input=answer,
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )

    @property
    def done(self) -> str:
        return self.log.read_text()


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    """Debian with Python 3.11, GL and venv; the user is not root, has a home and no sudo."""
    checkout, tools, home = tmp_path / "my check out", tmp_path / "bin", tmp_path / "home"
    for folder in (checkout, tools, home):
        folder.mkdir()
    shutil.copy(CHECKOUT / "run", checkout)
    shutil.copytree(LOCKS, checkout / ".lock")
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        (checkout / name).write_text(name)
    for name in ("phoslab", "fitting", "instruments", "render", "sample_data", "shaders"):
        (checkout / name).mkdir()
        (checkout / name / "__init__.py").write_text("")
    for tool in [*REAL_TOOLS, "basename"]:
        (tools / tool).symlink_to(str(shutil.which(tool)))
    log = tmp_path / "log"
    env = {"PATH": str(tools), "HOME": str(home), "LOG": str(log)}
    made = Machine(checkout, tools, log, env)
    made.has("python3", PYTHON)
    made.has("apt-get", LOGGED)
    made.has("dpkg", "#!/bin/sh\nexit 1\n")
    made.has("id", "#!/bin/sh\necho ${FAKE_UID:-1000}\n")
    made.has("uname", "#!/bin/sh\necho ${MACHINE:-x86_64}\n")
    return made


# --- what it says and asks ---


@pytest.mark.parametrize("arguments", [(), ("dmeo",)])
def test_bad_usage_shows_the_commands_and_exits_with_2(machine: Machine, arguments: tuple[str, ...]) -> None:
    done = machine.run(*arguments)
    assert done.returncode == 2
    assert "usage: ./run COMMAND" in done.stderr
    assert machine.done == ""


def test_an_old_python_is_named_with_the_remedy(machine: Machine) -> None:
    machine.env["VERSION"] = "3.9"
    done = machine.run("demo")
    assert done.returncode == 1
    assert "Python 3.9 is too old: phoslab needs 3.11 or newer. Install python3.11" in done.stderr


def test_a_newer_python_beside_an_old_one_is_found(machine: Machine) -> None:
    machine.has("python3", PYTHON.replace(":-3.11", ":-3.9"))
    machine.has("python3.12", PYTHON.replace(":-3.11", ":-3.12"))
    assert "with Python 3.12" in machine.run("test").stderr


def test_no_python_at_all_is_said(machine: Machine) -> None:
    (machine.tools / "python3").unlink()
    done = machine.run("demo")
    assert done.returncode == 1
    assert "There is no Python here" in done.stderr


@pytest.mark.parametrize(
    ("lacking", "packages"),
    [
        ({"NO_GL": "1"}, "libgl1 libegl1 libgl1-mesa-dri"),
        ({"NO_ENSUREPIP": "1"}, "python3.11-venv"),
        ({"VERSION": "3.14", "NO_HEADERS": "1"}, "g++ python3.14-dev"),
        ({"NO_ENSUREPIP": "1", "NO_GL": "1"}, "python3.11-venv libgl1 libegl1 libgl1-mesa-dri"),
    ],
)
def test_without_root_and_sudo_it_names_the_one_command_and_fails(
    machine: Machine, lacking: dict[str, str], packages: str
) -> None:
    machine.env |= lacking
    done = machine.run("demo")
    assert done.returncode == 1
    command = f"  apt-get update && apt-get install -y --no-install-recommends {packages}"
    assert done.stderr.splitlines()[-1].removesuffix(" libx11-dev") == command
    assert "apt-get" not in machine.done


@pytest.mark.parametrize("answer", ["", "\n", "n\n", "no\n"])
def test_anything_but_yes_installs_nothing(machine: Machine, answer: str) -> None:
    machine.has("sudo", SUDO)
    machine.env["NO_GL"] = "1"
    done = machine.run("demo", answer=answer)
    assert done.returncode == 1
    assert "libgl1 libegl1" in done.stderr
    assert "apt-get" not in machine.done
    assert "sudo" not in machine.done


def test_yes_installs_with_sudo(machine: Machine) -> None:
    machine.has("sudo", SUDO)
    machine.env["NO_GL"] = "1"
    machine.run("demo", answer="y\n")
    assert "sudo env DEBIAN_FRONTEND=noninteractive apt-get install" in machine.done


def test_with_ci_set_it_does_not_ask_and_sudo_may_not_ask_either(machine: Machine) -> None:
    machine.has("sudo", SUDO)
    machine.env |= {"NO_GL": "1", "CI": "true"}
    machine.run("demo")
    assert "sudo -n env DEBIAN_FRONTEND=noninteractive apt-get install" in machine.done


def test_root_installs_without_sudo(machine: Machine) -> None:
    machine.has("sudo", SUDO)
    machine.env |= {"NO_GL": "1", "FAKE_UID": "0"}
    machine.run("demo")
    assert "\napt-get install -qq -y --no-install-recommends libgl1" in machine.done
    assert "sudo" not in machine.done


def test_a_failing_apt_is_said_with_the_remedy(machine: Machine) -> None:
    machine.env |= {"NO_GL": "1", "FAKE_UID": "0"}
    machine.has("apt-get", "#!/bin/sh\nexit 100\n")
    done = machine.run("demo")
    assert done.returncode == 1
    assert "apt-get could not install libgl1 libegl1 libgl1-mesa-dri" in done.stderr


def test_packages_that_are_there_are_not_asked_for_again(machine: Machine) -> None:
    machine.has("dpkg", "#!/bin/sh\necho 'Status: install ok installed'\n")
    machine.env |= {"NO_GL": "1", "FAKE_UID": "0"}
    done = machine.run("test")
    assert done.returncode == 0
    assert "OpenGL does not start although its packages are installed" in done.stderr
    assert "apt-get" not in machine.done


def test_elsewhere_than_on_debian_it_names_the_libraries(machine: Machine) -> None:
    (machine.tools / "apt-get").unlink()
    machine.env["NO_GL"] = "1"
    done = machine.run("demo")
    assert done.returncode == 1
    for name in ("libGL.so.1", "libEGL.so.1", "DRI driver"):
        assert name in done.stderr


# --- environments ---


def test_a_second_run_installs_nothing(machine: Machine) -> None:
    assert machine.run("test").returncode == 0
    assert " install " in machine.done
    assert machine.run("test").returncode == 0
    assert "-m pip " not in machine.done


def test_an_environment_that_was_cut_short_is_made_anew(machine: Machine) -> None:
    machine.env["PIP_SAYS"] = "Killed"
    assert machine.run("test").returncode == 1
    leftover = machine.checkout / ".venv-test" / "leftover"
    leftover.write_text("half a package")
    del machine.env["PIP_SAYS"]
    assert machine.run("test").returncode == 0
    assert not leftover.exists()


def test_two_at_once_make_one_environment(machine: Machine) -> None:
    flock = shutil.which("flock")
    if flock is None:
        pytest.skip("flock is not here: apt-get install util-linux")
    (machine.tools / "flock").symlink_to(flock)
    (machine.tools / "sleep").symlink_to(str(shutil.which("sleep")))
    machine.has("python3", PYTHON.replace('cp "$0"', 'sleep 0.2; cp "$0"'))
    both = [subprocess.Popen([machine.checkout / "run", "test"], env=machine.env) for _ in range(2)]
    assert [one.wait(timeout=60) for one in both] == [0, 0]
    assert machine.done.count("-m venv") == 1


def test_new_locks_or_a_new_place_make_a_new_environment(machine: Machine) -> None:
    machine.run("test")
    with (machine.checkout / ".lock" / "test.txt").open("a") as lock:
        lock.write("six==1.16.0\n")
    machine.run("test")
    assert "-m venv" in machine.done
    machine.checkout = machine.checkout.rename(machine.checkout.with_name("moved"))
    machine.run("test")
    assert "-m venv" in machine.done


def test_a_changed_source_makes_a_new_wheel_in_the_same_environment(machine: Machine) -> None:
    machine.run("test")
    (machine.checkout / "render" / "__init__.py").write_text("changed")
    machine.run("test")
    assert "-m venv" not in machine.done
    assert "--force-reinstall" in machine.done


def test_the_wheel_is_built_from_sources_alone(machine: Machine) -> None:
    for stale in ("build/lib/phoslab/old.py", "phoslab.egg-info/SOURCES.txt", "render/__pycache__/old.pyc"):
        path = machine.checkout / stale
        path.parent.mkdir(parents=True)
        path.write_text("stale")
    before = {path for path in machine.checkout.iterdir() if not path.name.startswith(".")}
    machine.run("test")
    assert "./render/__init__.py" in machine.done
    for stale in ("old", "egg-info", "__pycache__", ".venv"):
        assert f"{stale}" not in re.sub(r"^python .*$", "", machine.done, flags=re.MULTILINE)
    assert {path for path in machine.checkout.iterdir() if not path.name.startswith(".")} == before


def test_on_a_common_machine_nothing_is_compiled(machine: Machine) -> None:
    machine.run("test")
    assert machine.done.count("--require-hashes") == machine.done.count("--only-binary :all:") > 0


@pytest.mark.parametrize("other", [{"VERSION": "3.14"}, {"MACHINE": "aarch64"}])
def test_where_not_all_is_ready_built_locked_sources_are_compiled(
    machine: Machine, other: dict[str, str]
) -> None:
    machine.has("dpkg", "#!/bin/sh\necho 'Status: install ok installed'\n")
    machine.env |= other
    assert machine.run("test").returncode == 0
    assert "--require-hashes -r .lock/test.txt" in machine.done


def test_pip_alone_serves_where_ensurepip_is_missing(machine: Machine) -> None:
    machine.env |= {"NO_ENSUREPIP": "1", "HAS_PIP": "1"}
    assert machine.run("test").returncode == 0
    assert f"--python {machine.checkout}/.venv-test/bin/python install" in machine.done


@pytest.mark.parametrize(
    ("pip_says", "sentence"),
    [
        ("connection broken by 'NewConnectionError('", "the package index cannot be reached"),
        ("ERROR: THESE PACKAGES DO NOT MATCH THE HASHES", "not the one that was locked"),
        ("[Errno 28] No space left on device", "The disk is full"),
        ("ERROR: No matching distribution found for rawpy", "no ready-built package for Python 3.11"),
    ],
)
def test_what_pip_says_is_said_in_one_sentence(machine: Machine, pip_says: str, sentence: str) -> None:
    machine.env["PIP_SAYS"] = pip_says
    done = machine.run("demo")
    assert done.returncode == 1
    assert sentence in done.stderr.splitlines()[-1]


def test_a_checkout_that_cannot_be_written_to_is_said(machine: Machine) -> None:
    machine.has("mkdir", "#!/bin/sh\nexit 1\n")
    done = machine.run("demo")
    assert done.returncode == 1
    assert "cannot be written to: copy this folder" in done.stderr


@pytest.mark.parametrize("home", [None, "", "/no/such/home"])
def test_without_a_home_everything_stays_in_the_checkout(machine: Machine, home: str | None) -> None:
    del machine.env["HOME"]
    if home is not None:
        machine.env["HOME"] = home
    assert machine.run("test").returncode == 0
    assert f"HOME={machine.checkout}/.venv-home" in machine.done


def test_a_users_pythonpath_does_not_reach_the_environment(machine: Machine) -> None:
    machine.env["PYTHONPATH"] = "/somewhere"
    machine.run("test")
    assert "PYTHONPATH=\n" in machine.done


def test_test_runs_pytests_own_script_with_its_arguments(machine: Machine) -> None:
    machine.has("python3", PYTHON.replace('echo "python', 'echo "$PHOSLAB_EXPECT_INSTALLED ${0##*/}'))
    machine.run("test", "-k", "two words")
    assert machine.done.splitlines()[-1] == "1 pytest -n 3 --dist worksteal -k two words"


# --- the script and the locks ---


def test_the_script_is_clean_posix_shell() -> None:
    if shutil.which("shellcheck") is None:
        pytest.skip("shellcheck is not here: apt-get install shellcheck")
    done = subprocess.run(
        ["shellcheck", "--shell=sh", CHECKOUT / "run"], capture_output=True, text=True, check=False
    )
    assert done.stdout == ""


def _locked(name: str) -> dict[str, list[Requirement]]:
    found: dict[str, list[Requirement]] = {}
    for line in (LOCKS / f"{name}.txt").read_text().splitlines():
        if line[:1].isalnum():
            requirement = Requirement(line.rstrip(" \\"))
            found.setdefault(_normal(requirement.name), []).append(requirement)
    return found


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


@pytest.mark.parametrize("name", ["build", "demo", "test", "dev"])
def test_every_locked_package_has_hashes_and_no_address(name: str) -> None:
    text = (LOCKS / f"{name}.txt").read_text()
    for entry in re.split(r"\n(?=\S)", text.strip()):
        assert entry.startswith("#") or re.search(r"== ?\S+.*\\\n +--hash=sha256:[0-9a-f]{64}", entry), entry
    assert not re.search(r"://|^-|@", text, re.MULTILINE)


def test_the_demo_environment_has_no_test_tools() -> None:
    assert not {"pytest", "hypothesis", "pytest-timeout", "mypy", "ruff", "import-linter"} & set(
        _locked("demo")
    )


def test_every_environment_has_the_same_versions() -> None:
    dev = _locked("dev")
    for name in ("demo", "test"):
        for package, versions in _locked(name).items():
            assert {str(r.specifier) for r in versions} == {str(r.specifier) for r in dev[package]}, package


def _asked(extras: dict[str, list[str]], name: str) -> list[str]:
    """What an extra asks for, with what the extras that it names (`phoslab[a,b]`) ask for."""
    wanted = []
    for requirement in map(Requirement, extras[name]):
        if requirement.name == "phoslab":
            wanted += [r for extra in requirement.extras for r in _asked(extras, extra)]
        else:
            wanted.append(str(requirement))
    return wanted


def test_locks_hold_what_pyproject_asks_for() -> None:
    project = tomllib.loads((CHECKOUT / "pyproject.toml").read_text())
    extras: dict[str, list[str]] = project["project"]["optional-dependencies"]
    base: list[str] = project["project"]["dependencies"]
    wanted: dict[str, list[str]] = {
        "build": project["build-system"]["requires"],
        "demo": base,
        "test": base + _asked(extras, "test"),
        "dev": base + _asked(extras, "dev"),
    }
    for name, requirements in wanted.items():
        locked = _locked(name)
        for requirement in map(Requirement, requirements):
            for lock in locked[_normal(requirement.name)]:
                version = str(lock.specifier).removeprefix("==")
                assert requirement.specifier.contains(version), f"{requirement}: ./run lock"
