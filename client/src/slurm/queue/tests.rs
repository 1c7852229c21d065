use super::*;

/// The lines of `squeue` give the tasks of this farm, matched by job name, and their states.
#[test]
fn squeue_lines_are_matched_by_job_name() {
    let task = |line: &str| task(line, "farm-worker@login:7700");
    let message = |state: &str, reason: &str| {
        let found = task(&format!("1234|17|{state}|{reason}|farm-worker@login:7700"));
        found.map(|(id, state)| (id.to_string(), state))
    };
    let is = |state: TaskState| Some(("1234_17".to_owned(), state));
    for waiting in ["PENDING", "REQUEUED"] {
        assert_eq!(message(waiting, "Resources"), is(TaskState::Waiting));
    }
    for held in ["JobHeldUser", "JobHeldAdmin", "launch failed requeued held"] {
        assert_eq!(message("PENDING", held), is(TaskState::Held), "{held}");
    }
    assert_eq!(message("SPECIAL_EXIT", "None"), is(TaskState::Held));
    // Completing tasks may be queued again; states of later versions of Slurm count as running, too.
    for running in ["RUNNING", "CONFIGURING", "SUSPENDED", "COMPLETING", "EXPEDITING"] {
        assert_eq!(message(running, "None"), is(TaskState::Running), "{running}");
    }
    for over in ["CANCELLED", "FAILED", "TIMEOUT", "COMPLETED", "NODE_FAIL"] {
        assert_eq!(message(over, "None"), None, "{over}");
    }
    assert_eq!(task("1234|17|RUNNING|None|farm-worker@login:7701"), None, "another farm's");
    assert_eq!(task("1234|17|RUNNING|None|my farm-worker@login:7700"), None);
    assert_eq!(task("1234|N/A|RUNNING|None|farm-worker@login:7700"), None, "no array");
    assert_eq!(task("CLUSTER: b"), None, "a heading where SLURM_CLUSTERS is set");
    assert_eq!(task(""), None);
}

#[test]
fn names_may_have_blanks_and_bars() {
    for name in ["night shift", "a|b", "blank at the end "] {
        let found = super::task(&format!("1|2|RUNNING|None|{name}"), name);
        assert_eq!(found, Some((TaskId { job: 1, task: 2 }, TaskState::Running)), "{name:?}");
    }
}

/// The answer of `sbatch` gives the number of the job.
#[test]
fn sbatch_answer_gives_the_job_number() {
    assert_eq!(job_id("17\n").unwrap(), 17);
    assert_eq!(job_id("17;other\n").unwrap(), 17);
    assert!(job_id("Submitted batch job 17").is_err());
}
