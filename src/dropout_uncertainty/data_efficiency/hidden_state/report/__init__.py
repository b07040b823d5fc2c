"""Where the state is hidden: the report of `hidden_state.prediction`, `control` and `language`."""
