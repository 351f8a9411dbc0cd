"""What several records say together: predictions, link finding, the posterior over faults."""
