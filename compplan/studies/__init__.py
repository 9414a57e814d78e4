"""Monte Carlo studies: comparison of compensation strategies under uncertainty, on one machine or a cluster.

    study = prepare_study(task, noise, strategies)            compplan.studies.study
    run   = run_study(study, samples, seed, folder, ...)      compplan.studies.runner
    run   -> summarise_run                                    compplan.studies.summary

A sample is one point of the unit cube. All random numbers of the sample follow from that point, so that results do not
depend on the number of workers. `kernel` solves the loaded equilibrium of many samples and waypoints at once.
"""
