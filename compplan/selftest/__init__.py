"""Self-test of the diagnosis: campaigns whose cause is known and hidden, and a score of the answers.

    case    = draw_case(number)              .draw: robot, campaign, later campaign and truth, from a seed
    record  = answer_case(case)              .study: what the diagnosis says, with no sight of the truth
    score   = score_answer(truth, answer)    .scoring
    summary = summarise_study(records)       .summary: rates, confusion, calibration, detection, withheld effects

The campaigns come from the product's own forward models; a study with campaigns of other software uses the same
scores.
"""
