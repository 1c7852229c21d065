# Workers on Nomad. The program is on the clients, the access file in a variable that only this job reads:
#
#   nomad var put nomad/jobs/farm-worker access=@worker.toml
#   nomad job run farm-worker.nomad.hcl
#   nomad job scale farm-worker workers 16

variable "worker" {
  type    = string
  default = "/usr/local/bin/farm-worker"
}

variable "threads" {
  type    = number
  default = 4
}

job "farm-worker" {
  type = "service"

  group "workers" {
    count = 4

    scaling {
      enabled = true
      min     = 0
      max     = 64
    }

    restart {
      attempts = 3
      interval = "10m"
      delay    = "30s"
      mode     = "delay"
    }

    task "farm-worker" {
      driver = "exec"

      config {
        command = var.worker
        args    = ["--access", "${NOMAD_SECRETS_DIR}/worker.toml", "--label", "nomad:${NOMAD_ALLOC_ID}", "--threads", "${var.threads}", "--grace", "30s"]
      }

      template {
        data        = "{{ with nomadVar \"nomad/jobs/farm-worker\" }}{{ .access }}{{ end }}"
        destination = "secrets/worker.toml"
        perms       = "600"
      }

      # Time to deliver finished results, and to hand the leases back.
      kill_signal  = "SIGTERM"
      kill_timeout = "45s"

      resources {
        cores  = var.threads
        memory = 1024
      }
    }
  }
}
