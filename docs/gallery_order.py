"""The order of the examples: what a newcomer wants to see first."""

ORDER = (
    "plot_three_tank.py",
    "plot_log_to_name.py",
    "plot_given_and_identified.py",
    "plot_bank_three_tank.py",
    "plot_jet_engine.py",
    "plot_wind_turbine.py",
    "plot_detectability.py",
    "plot_campaign_three_tank.py",
    "plot_campaign_jet_engine.py",
    "plot_campaign_aircraft.py",
    "plot_fault_estimation.py",
    "plot_sensor_fault_estimation.py",
    "plot_accommodation.py",
    "plot_singular_plant.py",
    "plot_directions.py",
    "plot_matched_filters.py",
    "plot_gertler_examples.py",
    "plot_uncertain_plants.py",
    "plot_robust_l1.py",
    "plot_live.py",
)


def by_interest(filename: str) -> int:
    """Return the place of an example; new ones come last."""
    return ORDER.index(filename) if filename in ORDER else len(ORDER)
