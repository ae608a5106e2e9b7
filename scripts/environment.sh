# Sourced by test.sh and demo.sh: makes the repository's own Python environment in .venv, once.
#
#   make_environment dev       everything the tests need
#   make_environment runtime   what the package itself needs
#   make_environment lowest    as dev, in .venv-lowest, with the lowest version that pyproject.toml declares of everything
#   make_environment highest   as dev, in .venv-highest, with the newest versions within the declared ranges
#
# The last two are resolved by uv, torch with them: where no index of its CPU builds is set up (UV_TORCH_BACKEND=cpu, or
# UV_FIND_LINKS with such wheels), that brings gigabytes of CUDA libraries on Linux. TORCHHAND_TORCH=2.13.0 takes that
# version of torch in place of the lowest or newest one.
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
    case "$kind" in lowest | highest)
        make_extreme_environment "$kind"
        return
        ;;
    esac
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
    # torch first and by itself: the largest download, and the others then find it in place. Bytecode is made of what is
    # imported, when it is: of all files it takes as long as installing them.
    "$python" -m pip install $quiet --no-compile -c "$repository/scripts/constraints.txt" torch || return 1
    "$python" -m pip install $quiet --no-compile -c "$repository/scripts/constraints.txt" -e "$requirement" || return 1
    echo "$stamp" >"$environment/stamp-$kind"
}

make_extreme_environment() {
    local kind="$1" resolution="$1" stamp base
    [ "$kind" = lowest ] && resolution=lowest-direct # of what pyproject.toml names; what that needs in turn is new
    environment="$repository/.venv-$kind"
    python="$environment/bin/python"
    stamp="$(cksum <"$repository/pyproject.toml") $repository torch ${TORCHHAND_TORCH:-$kind}"
    if [ "$(cat "$environment/stamp" 2>/dev/null)" = "$stamp" ] && "$python" -c '' 2>/dev/null; then
        return
    fi

    base="$(find_base_python)" || return 1
    echo "Making the environment in .venv-$kind (minutes; 2 GB of disk, 6 GB where torch comes with CUDA)."
    "$base" -m venv --clear "$environment" || return 1
    "$python" -m pip install --quiet -c "$repository/scripts/constraints.txt" uv || return 1
    export UV_FIND_LINKS="${UV_FIND_LINKS:-${PIP_FIND_LINKS:-}}"
    echo "torch${TORCHHAND_TORCH:+==$TORCHHAND_TORCH}" >"$environment/torch.txt"
    "$environment/bin/uv" pip compile --quiet --python "$python" --resolution "$resolution" --extra dev \
        -c "$environment/torch.txt" "$repository/pyproject.toml" -o "$environment/requirements.txt" >/dev/null || return 1
    "$environment/bin/uv" pip install --quiet --python "$python" -r "$environment/requirements.txt" || return 1
    "$environment/bin/uv" pip install --quiet --python "$python" --no-deps --no-build-isolation -e "$repository" || return 1
    echo "$stamp" >"$environment/stamp"
}
