# shellcheck shell=bash
# Tests the image's final stage without an engine: the programs, the libraries that they need, a user and nothing else; a
# read-only root, /data and /tmp to write to, no capabilities. Sourced by ../check within separate namespaces, where it
# is process 1: all other processes are killed when it ends. Commands and variables are those of compose.yaml.
#
# root_trial FOLDER: the folder is empty, and removed by the caller, who also sets these:
: "${bin:?}" "${deploy:?}" "${checks:?}" "${python:?}"

# Libraries of gcr.io/distroless/cc-debian12 that programs may need.
readonly base_libraries="libc.so.6 libm.so.6 libgcc_s.so.1 ld-linux-x86-64.so.2 ld-linux-aarch64.so.1"

root_trial() {
  tree=$1/root
  work=$1/work
  mkdir -p "$work"
  ip link set lo up
  make_tree
  make_access
  close_tree
  run_farm
}

make_tree() {
  local program library
  mkdir -p "$tree"/{usr/local/bin,data,tmp,proc,etc,run/secrets}
  for program in farm-coordinator farm-worker farmctl; do
    cp "$bin/$program" "$tree/usr/local/bin/"
    while read -r library; do
      [[ " $base_libraries " == *" ${library##*/} "* ]] || fail "$program needs ${library##*/}, which the image does not have"
      install -D "$(realpath "$library")" "$tree$library"
    done < <(ldd "$bin/$program" | grep -o '/[^ ]*')
  done
  echo "nonroot:x:65532:65532:nonroot:/data:/sbin/nologin" >"$tree/etc/passwd"
  echo "nonroot:x:65532:" >"$tree/etc/group"
  printf '127.0.0.1 localhost coordinator\n' >"$tree/etc/hosts"
  say "the image's tree: $(du -sh "$tree" | cut -f1), with $(find "$tree" -name '*.so*' | wc -l) libraries"
}

# As in the head of compose.yaml; Compose mounts a secret with its owner and mode.
make_access() {
  local role
  "$bin/farmctl" --quiet access create "$work/access" --host coordinator >/dev/null
  sed 's/^token = .*/token = "0123456789abcdef0123456789abcdef"/' "$work/access/worker.toml" >"$work/access/stranger.toml"
  for role in coordinator worker client stranger; do
    install -o 65532 -m 400 "$work/access/$role.toml" "$tree/run/secrets/$role"
  done
}

close_tree() {
  mount --bind "$tree" "$tree"
  mount -t tmpfs -o mode=0700,uid=65532,gid=65532 tmpfs "$tree/data"
  mount -t tmpfs -o mode=1777 tmpfs "$tree/tmp"
  mount -t proc proc "$tree/proc"
  mount -o remount,bind,ro "$tree"
  if touch "$tree/usr/local/bin/x" 2>/dev/null; then fail "the root can be written to"; fi
}

# inside COMMAND...: runs a command as the image's user, without further privileges, with the variables of the service.
inside() { (become "$@"); }

# Replaces the shell, so that its process number is the program's.
become() {
  exec env -i PATH=/usr/local/bin FARM_DATA=/data "${variables[@]}" \
    "$(type -P setpriv)" --no-new-privs "$(type -P chroot)" --userspec=65532:65532 --groups=65532 "$tree" "$@"
}

# service NAME: reads variables and command of a service of compose.yaml.
service() {
  local word
  variables=()
  command=()
  while read -r word; do
    if [[ ${#command[@]} -eq 0 && $word == [A-Z]*=* ]]; then variables+=("$word"); else command+=("$word"); fi
  done < <("$python" "$checks/compose.py" --run "$deploy/compose/compose.yaml" "$1")
}

start() {
  service "$1"
  (become "${command[@]}") >"$work/$1.log" 2>&1 &
  pids[$1]=$!
}

# stop NAME SECONDS: sends SIGTERM; the program must end in time with exit code 0.
stop() {
  local began=$SECONDS status=0
  kill -TERM "${pids[$1]}"
  timeout "$2" tail --pid="${pids[$1]}" -f /dev/null || fail "$1 still runs $2 s after SIGTERM: $(tail -n 5 "$work/$1.log")"
  wait "${pids[$1]}" || status=$?
  [[ $status -eq 0 ]] || fail "$1 ends with exit code $status after SIGTERM: $(tail -n 5 "$work/$1.log")"
  say "$1 ended $((SECONDS - began)) s after SIGTERM with exit code 0"
}

# healthy SERVICE: the result of the image's HEALTHCHECK in that container.
healthy() {
  local words
  service "$1"
  read -ra words < <(sed -n 's/^HEALTHCHECK.* CMD \[\(.*\)\]/\1/p' "$deploy/container/Containerfile" | tr -d '",')
  inside "${words[@]}" >"$work/health.log" 2>&1
}

# http PATH: prints the whole answer of the metrics port.
http() {
  exec 9<>/dev/tcp/127.0.0.1/7701 || return 1
  printf 'GET %s HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n' "$1" >&9
  timeout 10 cat <&9
  exec 9>&-
}

# Checks that the metrics of the alerts in README.md exist.
check_metrics() {
  local name
  while read -r name; do
    grep -q "^${name}[{ ]" "$1" || fail "README.md has an alert on $name, which is not among the metrics"
  done < <(sed -n 's/^ *expr: //p' "$deploy/README.md" | grep -o 'farm_[a-z_]*' | sort -u)
}

as_client() {
  variables=(FARM_ACCESS=/run/secrets/client)
  inside farmctl --quiet "$@"
}

digest_of() { grep -o '"records_digest":"[^"]*"' | cut -d '"' -f 4; }

# The first number is that of the whole farm.
leased() { [[ $(as_client --json status | grep -o '"jobs_leased":[0-9]*' | head -n 1) != '"jobs_leased":0' ]]; }

write_grid() {
  cat >"$1" <<GRID
sigma_t_per_mm = [4.0, 6.0]
albedo = [0.9, 0.99, 0.999]
g = [0.0, 0.4, 0.8]
thickness_mm = [0.5, 1.0]
walks = $2
GRID
}

run_farm() {
  local expected found path status
  declare -gA pids
  write_grid "$tree/data/small.toml" 25000
  write_grid "$tree/data/large.toml" 50000000
  "$bin/farmctl" --local --data "$work/embedded" --quiet submit "$tree/data/small.toml" >/dev/null
  expected=$("$bin/farmctl" --local --data "$work/embedded" --json show small | digest_of)
  start coordinator
  patiently 30 healthy coordinator || fail "the coordinator is not healthy: $(cat "$work/health.log" "$work/coordinator.log")"
  start worker
  healthy worker || fail "the worker's health check fails: $(cat "$work/health.log")"
  for path in /livez /readyz /metrics; do
    http "$path" >"$work/answer"
    [[ $(head -n 1 "$work/answer") == *" 200 "* ]] || fail "$path on the metrics port does not answer 200"
  done
  check_metrics "$work/answer"
  say "coordinator and worker run on a read-only root as user 65532, and are healthy"
  as_client submit /data/small.toml --wait >/dev/null || fail "small.toml is not computed: $(tail -n 5 "$work/worker.log")"
  found=$(as_client --json show small | digest_of)
  [[ -n $expected && $found == "$expected" ]] || fail "records digest $found, in one process $expected"
  say "a small grid is done; records digest $found as in one process"
  variables=(FARM_ACCESS=/run/secrets/stranger)
  status=0
  inside farm-worker >"$work/stranger.log" 2>&1 || status=$?
  [[ $status -eq 4 ]] || fail "a worker with a wrong token ends with exit code $status, not 4: $(cat "$work/stranger.log")"
  say "a worker with a wrong token ends with exit code 4"
  as_client submit /data/large.toml >/dev/null
  patiently 20 leased || fail "the worker takes no jobs: $(tail -n 5 "$work/worker.log")"
  stop worker 45
  if leased; then fail "the worker did not hand its leases back"; fi
  stop coordinator 10
  if healthy coordinator; then fail "the health check does not see that the coordinator has ended"; fi
  [[ -z $(find "$tree" -xdev -newer "$tree/etc/hosts" -type f -not -path '*/run/secrets/*') ]] ||
    fail "something was written to the root"
}
