# Sourced by test.sh and demo.sh: makes the repository's own Python environment in .venv, once.
#
#   make_environment dev       everything the tests need
#   make_environment runtime   what the package itself needs
#
# Sets `python` to the environment's interpreter. The environment is reused while pyproject.toml, the constraints and the
# repository's place are unchanged. TORCHHAND_PYTHON names the interpreter to build from, where python3 is not the one.

repository="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"
environment="$repository/.venv"
python="$environment/bin/python"

find_base_python() {
    local candidate
    for candidate in ${TORCHHAND_PYTHON:-} python3 python3.13 python3.12 python3.11 python; do
        if "$candidate" -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
            echo "$candidate"
            return
        fi
    done
    echo "No Python 3.11 or newer with the venv module found; install one (Debian, Ubuntu: python3 python3-venv)" \
        "or name it in TORCHHAND_PYTHON." >&2
    return 1
}

make_environment() {
    local kind="$1" requirement="$repository" quiet="" stamp base other
    [ "$kind" = dev ] && requirement="$repository[dev]"
    stamp="$(cat "$repository/pyproject.toml" "$repository/scripts/constraints.txt" | cksum) $repository"
    for other in "$kind" dev; do # what is enough for the tests is enough for the demo
        if [ "$(cat "$environment/stamp-$other" 2>/dev/null)" = "$stamp" ] && "$python" -c '' 2>/dev/null; then
            return
        fi
    done

    base="$(find_base_python)" || return 1
    echo "Making the environment in .venv (a few minutes, about 2 GB of disk; only once)."
    if [ "$(cat "$environment/stamp-runtime" 2>/dev/null)" != "$stamp" ]; then
        "$base" -m venv --clear "$environment" || return 1
    fi
    [ -t 1 ] || quiet=--quiet # progress bars only where someone looks at them
    # torch first and by itself: the largest download, and the others then find it in place.
    "$python" -m pip install $quiet -c "$repository/scripts/constraints.txt" torch || return 1
    "$python" -m pip install $quiet -c "$repository/scripts/constraints.txt" -e "$requirement" || return 1
    echo "$stamp" >"$environment/stamp-$kind"
}
