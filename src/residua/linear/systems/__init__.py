"""Linear systems as values: state-space and descriptor systems, their scaling, sampling and simulation."""
