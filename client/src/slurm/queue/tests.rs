use super::*;

/// The lines of `squeue` give the tasks of this farm, matched by job name, and their states.
#[test]
fn squeue_lines_are_matched_by_job_name() {
    let task = |line: &str| task(line, "farm-worker@login:7700");
    // Completing tasks may be queued again; states of later versions of Slurm count as running, too.
    for (state, reasons, expected) in [
        ("PENDING REQUEUED", "Resources", Some(TaskState::Waiting)),
        ("PENDING", "JobHeldUser,JobHeldAdmin,launch failed requeued held", Some(TaskState::Held)),
        ("SPECIAL_EXIT", "None", Some(TaskState::Held)),
        ("RUNNING CONFIGURING SUSPENDED COMPLETING EXPEDITING", "None", Some(TaskState::Running)),
        ("CANCELLED FAILED TIMEOUT COMPLETED NODE_FAIL", "None", None),
    ] {
        for (state, reason) in state.split(' ').flat_map(|s| reasons.split(',').map(move |r| (s, r))) {
            let found = task(&format!("1234|17|{state}|{reason}|farm-worker@login:7700"));
            let found = found.map(|(id, state)| (id.to_string(), state));
            assert_eq!(found, expected.map(|state| ("1234_17".to_owned(), state)), "{state} {reason}");
        }
    }
    for (line, what) in [
        ("1234|17|RUNNING|None|farm-worker@login:7701", "another farm's"),
        ("1234|17|RUNNING|None|my farm-worker@login:7700", "another name"),
        ("1234|N/A|RUNNING|None|farm-worker@login:7700", "no array"),
        ("CLUSTER: b", "a heading where SLURM_CLUSTERS is set"),
        ("", "no line"),
    ] {
        assert_eq!(task(line), None, "{what}");
    }
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
