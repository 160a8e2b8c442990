"""A monitor on data as they come: sources, sampling, alarms as events, a store that loses nothing, sinks, a page."""
