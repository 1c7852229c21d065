use super::*;

#[test]
fn lines_of_squeue_tell_tasks_by_the_name_of_their_job() {
    let task = |line: &str| task(line, "farm-worker@login:7700");
    let id = TaskId { job: 1234, task: 17 };
    let told = |state: &str| task(&format!("1234 17 {state} farm-worker@login:7700"));
    assert_eq!(told("PENDING"), Some((id, TaskState::Waiting)));
    assert_eq!(told("REQUEUED"), Some((id, TaskState::Waiting)));
    assert_eq!(told("RUNNING"), Some((id, TaskState::Running)));
    assert_eq!(told("CONFIGURING"), Some((id, TaskState::Running)));
    for over in ["COMPLETING", "CANCELLED", "FAILED", "TIMEOUT", "COMPLETED"] {
        assert_eq!(told(over), None, "{over}");
    }
    assert_eq!(task("1234 17 RUNNING farm-worker@login:7701"), None, "another farm's");
    assert_eq!(task("1234 17 RUNNING my farm-worker@login:7700"), None);
    assert_eq!(task("1234 N/A RUNNING farm-worker@login:7700"), None, "no array");
    assert_eq!(task(""), None);
}

#[test]
fn sbatch_tells_the_number_of_a_job() {
    assert_eq!(job_id("17\n").unwrap(), 17);
    assert_eq!(job_id("17;other-cluster\n").unwrap(), 17);
    assert!(job_id("Submitted batch job 17").is_err());
}
