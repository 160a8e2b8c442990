"""Detection filters: each fault moves the residual in a direction of its own."""
