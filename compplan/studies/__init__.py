"""Monte Carlo studies: compensation strategies against each other under uncertainty, on one machine or many.

    study = prepare_study(task, noise, strategies)            compplan.studies.study
    run   = run_study(study, samples, seed, folder, ...)      compplan.studies.runner
    run   -> summarise_run                                    compplan.studies.summary

A sample is one point of the unit cube; everything random in it follows from that point, so that a sample is the same
whoever computes it. `kernel` solves the loaded equilibrium of many samples and waypoints at once.
"""
