"""Where the state is hidden: the report of `hidden_state.prediction` and `hidden_state.language`."""
