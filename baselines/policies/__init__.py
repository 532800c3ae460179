"""Reference policies by id, as "module:factory" strings; the only modules that read observation dictionaries."""

POLICIES: dict[str, dict[str, str]] = {
    "aerograsp/Detect-v0": {
        "clusters+icp": "baselines.policies.detect:clusters_icp",
        "features+pnp": "baselines.policies.detect:features_pnp",
        "oracle-truth": "baselines.policies.detect:truth",
    },
    "aerograsp/Dock-v0": {
        "pid": "baselines.policies.dock:pid",
        "pid-tuned": "baselines.policies.dock:pid_tuned",
        "lqg": "baselines.policies.dock:lqg",
    },
    "aerograsp/DockAttach-v0": {
        "pid": "baselines.policies.dock_attach:pid",
        "pid-tuned": "baselines.policies.dock_attach:pid_tuned",
    },
    "aerograsp/DockManipulate-v0": {
        "dock-dls": "baselines.policies.dock_manipulate:dls",
        "dock-dls-pid": "baselines.policies.dock_manipulate:pid_dls",
    },
    "aerograsp/GraspPlan-v0": {
        "gpis": "baselines.policies.grasp_plan:gpis",
        "gpis-constant": "baselines.policies.grasp_plan:gpis_constant",
        "cloud": "baselines.policies.grasp_plan:cloud",
        "com": "baselines.policies.grasp_plan:com",
        "random-eligible": "baselines.policies.grasp_plan:random_eligible",
        "oracle-mesh": "baselines.policies.grasp_plan:oracle_mesh",
    },
    "aerograsp/Reach-v0": {
        "dls": "baselines.policies.reach:dls",
        "dls-no-feedforward": "baselines.policies.reach:dls_no_feedforward",
    },
    "aerograsp/Grasp-v0": {
        "grasp-dls": "baselines.policies.grasp:grasp_dls",
    },
    "aerograsp/GraspDual-v0": {
        "dual-dls": "baselines.policies.grasp_dual:dual_dls",
    },
}
