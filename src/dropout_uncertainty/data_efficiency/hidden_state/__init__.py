"""Where the state is hidden: a recurrent network with held masks, on text and on a cart-pole without its velocities."""
