"""Reads a submit file as condor_submit does, by HTCondor's own library, and prints the command of the first job.

    htcondor_jobs.py SUBMIT_FILE WORKERS

The jobs must differ in their arguments and request whole numbers of cores and MiB; jobs that end with success or are
refused for good must leave the queue, and all others must stay. The program and the transferred files must be in the
current folder.
"""

import os
import sys

os.environ["CONDOR_CONFIG"] = "/dev/null"

import htcondor  # noqa: E402


def leaves(ad, by_signal, code):
    ad["ExitBySignal"], ad["ExitCode"] = by_signal, code
    return bool(ad.eval("OnExitRemove"))


def main():
    path, workers = sys.argv[1], int(sys.argv[2])
    with open(path) as file:
        submit = htcondor.Submit(file.read())
    submit["workers"] = str(workers)
    ads = list(submit.jobs(clusterid=7))
    if len(ads) != workers or len({ad["Args"] for ad in ads}) != workers:
        raise SystemExit(f"{path}: {len(ads)} jobs of {workers}, with the arguments {[ad['Args'] for ad in ads]}")
    for ad in ads:
        for name in ("RequestCpus", "RequestMemory", "RequestDisk", "JobMaxVacateTime"):
            if not isinstance(ad.eval(name), int):
                raise SystemExit(f"{path}: {name} is {ad[name]}, and no whole number")
    lets_go = [(by, code) for by, code in ((False, 1), (False, 2), (True, 9)) if leaves(ads[0], by, code)]
    keeps = [code for code in (0, 4) if not leaves(ads[0], False, code)]
    if lets_go or keeps:
        raise SystemExit(f"{path}: on_exit_remove keeps exit codes {keeps} and lets go {lets_go}")
    print(ads[0]["KillSig"], ads[0]["Cmd"], ads[0]["Args"])


if __name__ == "__main__":
    main()
