"""The scalable O-VIB encoder: model, rate terms, objective, training and baselines."""
