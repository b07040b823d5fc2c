"""What doubt is worth: the report of `ablations.doubt`, `literal`, `mchutchon`, `shrinking` and `gradients`."""
