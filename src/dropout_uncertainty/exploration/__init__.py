"""Section 5.3: exploration in a 2D world, where Thompson sampling takes one draw of the weights per decision."""
