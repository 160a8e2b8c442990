"""A monitor on live data: sources, sampling, alarms as events, a store that loses nothing, sinks, a page."""
