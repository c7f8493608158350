"""The O-VIB encoder: network, composite loss, rate terms, training, rivals and information-theoretic bounds."""
