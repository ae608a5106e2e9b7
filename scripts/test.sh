#!/usr/bin/env bash
# Style, types, import layers, dead code and tests, in an environment of the repository's own. Arguments go to pytest:
#   bash scripts/test.sh -k unscented
#   bash scripts/test.sh --lowest     the tests alone, with the lowest version that is declared of every dependency
#   bash scripts/test.sh --highest    the same with the newest ones (both: see environment.sh for what torch brings)
# Exit code 0 only when everything passes; pytest's summary is the last line.
set -uo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/environment.sh"
cd "$repository" || exit 1
kind=dev
case "${1:-}" in --lowest | --highest)
    kind="${1#--}"
    shift
    ;;
esac
make_environment "$kind" || exit 1
unset PYTHONDONTWRITEBYTECODE # every process would compile the package anew: seconds, some hundred times

failed=0
check() {
    echo "== $1"
    shift
    "$@" || failed=1
}
# Both workers of the tests below would compile all modules by themselves: done once, beside the checks.
"$python" -m pytest --collect-only -q >/dev/null 2>&1 &
if [ "$kind" = dev ]; then # of other versions, the checkers have other opinions
    check "ruff check" "$python" -m ruff check .
    check "ruff format" "$python" -m ruff format --check .
    check "pyright" "$python" -m pyright --pythonpath "$python"
    check "import layers" "$environment/bin/lint-imports"
    check "nothing that only tests reach" "$python" -m vulture
    if "$python" -c 'import mkdocs, mkdocstrings' 2>/dev/null; then # the extra docs, which the tests do not need
        check "pages" env NO_MKDOCS_2_WARNING=1 "$python" -m mkdocs build -q -f .mkdocs.yml --strict -d "$(mktemp -d)"
    fi
    [ "$failed" = 0 ] || echo "One of the checks above failed; the tests run all the same."
fi
wait
echo "== pytest, compiled and exported hands"
# Without the checks of shapes at run time, which torch.compile cannot follow.
JAXTYPING_DISABLE=1 OMP_NUM_THREADS=1 "$python" -m pytest -n 2 --dist loadfile tests/compiled \
    --override-ini "addopts=--import-mode=importlib" || failed=1
echo "== pytest"
# Two workers, each with one thread; a file's tests stay together, as their fixtures do.
OMP_NUM_THREADS=1 "$python" -m pytest -n 2 --dist loadfile "$@" || failed=1
exit "$failed"
