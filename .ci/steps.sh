# shellcheck shell=bash
# Shared by `.ci/run` and `.ci/long`, which source it: steps with a table of their times, background jobs, a watchdog
# and the installation of programs. Changes to the repository's root and makes a temporary folder, `$work`.
set -uo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.." || exit

# shellcheck disable=SC2034 # used by both scripts
readonly DENY_VERSION=0.20.2
# A step returns this status if this machine cannot do it.
readonly CANNOT=75

# Each crate is built once, so data for incremental builds costs time and disk space only.
export CARGO_INCREMENTAL=0
# Failed assertions name their line without debug information.
export CARGO_PROFILE_DEV_DEBUG=0
# If rustup neither has nor fetches the toolchain of rust-toolchain.toml, the installed stable one has to do.
rustc --version >/dev/null 2>&1 || export RUSTUP_TOOLCHAIN=stable

work=$(mktemp -d)
table=$work/table
: >"$table"
started=$(date +%s)
left_out=() failed=()

# Prints all child processes of process `$1`, recursively, except process `$2` and its children.
descendants() {
    local child
    for child in $(pgrep -P "$1"); do
        [ "$child" = "${2:-}" ] || { descendants "$child" "${2:-}" && echo "$child"; }
    done
}

# shellcheck disable=SC2046 # the list of process numbers is split on purpose
trap 'kill $(descendants $$) 2>/dev/null; rm -rf "$work"' EXIT

clock() { printf '%d:%02d' $(($1 / 60)) $(($1 % 60)); }

row() { printf '%-58s %7s  %s\n' "$1" "$2" "$3" >>"$table"; }

# Ends the script with the table. The last line names all steps that failed or that this machine cannot do.
finish() {
    local verdict=passed omitted=
    row "together" "$(clock $(($(date +%s) - started)))" ""
    [ ${#failed[@]} = 0 ] || verdict="FAILED: $(printf '%s; ' "${failed[@]}")"
    [ ${#left_out[@]} = 0 ] || omitted=", but LEFT OUT: $(printf '%s; ' "${left_out[@]}")"
    printf '\n== steps, minutes and seconds, results of test runners\n'
    cat "$table"
    printf '\n%s\n' "${verdict%; }${omitted%; }"
    [ "$verdict" = passed ]
    exit
}

# Runs a step, given as name and command. The first failure ends the script, unless `keep_going` is set.
step() {
    local name=$1 begun status outcome=
    shift
    printf '\n== %s\n' "$name"
    begun=$(date +%s)
    "$@" 2>&1 </dev/null | tee "$work/output"
    status=${PIPESTATUS[0]}
    case $status in
    0) ;;
    "$CANNOT") outcome="LEFT OUT" && left_out+=("$name") ;;
    *) outcome="FAILED with status $status" && failed+=("$name") ;;
    esac
    row "$name" "$(clock $(($(date +%s) - begun)))" "$outcome"
    sed -n '/: ok\. 0 passed/d; s/^test result: \(.*\); 0 measured; .* filtered out; /    \1; /p' "$work/output" >>"$table"
    [ ${#failed[@]} = 0 ] || { [ "${keep_going:-}" ] && [ ! -e "$work/timed_out" ]; } || finish
}

# Runs a job, given as name and command, for `await`.
job() {
    local name=$1 begun
    shift
    begun=$(date +%s)
    "$@" >"$work/$name.output" 2>&1 </dev/null
    local status=$?
    echo "$name took $(clock $(($(date +%s) - begun)))" >>"$work/$name.output"
    echo $status >"$work/$name.status"
}

# Starts a background job, given as name and command.
begin() { job "$@" & }

# Starts functions as background jobs of their names, one after the other.
begin_in_turn() { for name; do job "$name" "$name"; done & }

# Waits for a background job, prints its last lines and returns its status.
await() {
    until [ -s "$work/$1.status" ]; do sleep 0.2; done
    tail -n 30 "$work/$1.output"
    return "$(cat "$work/$1.status")"
}

# After `$1` minutes, lists the running processes of the script and ends them: they show which step hangs.
begin_watchdog() {
    (
        own=$BASHPID
        sleep $(($1 * 60)) &
        trap 'kill $! 2>/dev/null; exit' TERM
        wait $!
        touch "$work/timed_out"
        mapfile -t running < <(descendants $$ "$own")
        printf '\n== still running after %s minutes\n' "$1"
        ps -o pid,ppid,etime,stat,wchan:24,args -p "$(IFS=, && echo "${running[*]}")" | cut -c 1-160
        # tests that the runner reported as slow and that have not ended since
        sed -n 's/^test \(.*\) has been running for over .*/\1/p' "$work/output" | while read -r name; do
            grep -q "^test $name \.\.\. " "$work/output" || echo "test $name has no result"
        done
        kill "${running[@]}" 2>/dev/null
    ) &
}

# Takes pairs `COMMAND=PACKAGE` and installs the Debian packages of the missing commands. A command from another source
# is not replaced.
debian() {
    local pair missing=()
    for pair in "$@"; do
        command -v "${pair%%=*}" >/dev/null || missing+=("${pair#*=}")
    done
    [ ${#missing[@]} = 0 ] && return
    apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends \
        "${missing[@]}" || return "$CANNOT"
}

# Installs the receivers of alarms, promtool and PostgreSQL. A test that misses its program prints that it was skipped.
test_programs() {
    local status=0
    debian prometheus-alertmanager=prometheus-alertmanager promtool=prometheus mosquitto_passwd=mosquitto \
        mosquitto_sub=mosquitto-clients /usr/bin/aiosmtpd=python3-aiosmtpd curl=curl openssl=openssl || status=$?
    debian /usr/lib/postgresql/15/bin/initdb=postgresql-15 || status=$?
    return "$status"
}

has_cargo_command() { [ "$(cargo "$1" --version 2>/dev/null)" = "cargo-$1 $2" ]; }

licences() { cargo deny check bans licenses sources; }

# Builds the program that people get, at niceness `$1`. Without `-p`, dependencies have the features that the README's
# `cargo run --release` gives them, and are not built again.
release_build() { nice -n "$1" cargo build --release --bin armwatch; }

# The first command of the README, on the program that is built already.
demo() { timeout 60 cargo run --release -- demo --once --dir "$work/demo"; }

# Runs ignored integration tests. Without `-p`, dependencies have the features of `cargo test` and are not built again.
ignored() { cargo test --test integration -- --ignored "$@"; }

# A fault at system calls of a scenario, on the program that is built already. `tests/faults/run` takes the options.
faults() {
    debian python3=python3 || return
    tests/faults/run target/release/armwatch "$@"
}

# Syncs of the archive that do nothing: the harness must find the lost exports, which it reports with status 1.
planted_bug() {
    faults --lie archive --mode power --share 400 >"$work/planted"
    local status=$?
    tail -n 3 "$work/planted"
    [ "$status" != "$CANNOT" ] || return "$CANNOT"
    [ "$status" = 1 ]
}
