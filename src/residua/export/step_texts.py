"""Steps of a monitor on each sample, as text of :mod:`residua.export.program`, in the order of the fused loop's sums.

Names in capitals are sizes, and settings that are known when a monitor is exported.
"""

#: Deviations from the operating point; values outside of the plausible range, or NaN, are missing.
TAKE = """
complete = True
for j in range(INPUTS):
    deviation = u[j] - offset[j]
    if deviation >= lowest[j] and deviation <= highest[j]:
        held[j] = deviation
    else:
        complete = False
for j in range(OUTPUTS):
    deviation = y[j] - offset[INPUTS + j]
    if deviation >= lowest[INPUTS + j] and deviation <= highest[INPUTS + j]:
        held[INPUTS + j] = deviation
    else:
        complete = False
"""

_STOP = """
running = False
starting = False
for i in range(STATES):
    x[i] = 0.0
if FIRST > 0:
    for i in range(STATES):
        start_sums[i] = 0.0
"""

_START = f"""
{_STOP}
for i in range(STATES):
    total = 0.0
    for j in range(CHANNELS):
        total = total + held[j] * start_matrix[i * CHANNELS + j]
    x[i] = total
running = True
if FIRST > 0:
    starting = True
age = 0
gap = 0
fresh = True
"""

_FILTER = """
for i in range(STATES):
    before[i] = x[i]
for i in range(RESIDUALS):
    total = 0.0
    for j in range(CHANNELS):
        total = total + feed_matrix[i * CHANNELS + j] * held[j]
    for j in range(STATES):
        total = total + output_matrix[i * STATES + j] * before[j]
    residual[i] = total
for i in range(STATES):
    total = 0.0
    for j in range(CHANNELS):
        total = total + input_matrix[i * CHANNELS + j] * held[j]
    for j in range(STATES):
        total = total + state_matrix[i * STATES + j] * before[j]
    x[i] = total
if STATES > 0:
    at_rest = True
    for j in range(CHANNELS):
        if held[j] != 0.0:
            at_rest = False
    if at_rest:
        for i in range(STATES):
            if x[i] < smallest and x[i] > -smallest:
                x[i] = 0.0
"""


def _indented(text: str, levels: int) -> str:
    return "\n".join(" " * 4 * levels + line if line else line for line in text.strip("\n").split("\n"))


#: The filter: starts, holds missing values, restarts after long gaps and overflows. Twice at most: after a start.
RUN = f"""
known = False
passed = False
pending = True
for attempt in range(2):
    if pending:
        fresh = False
        if not running:
            if complete:
{_indented(_START, 4)}
            else:
                if gap < most:
                    gap = gap + 1
                pending = False
        if pending and not complete and gap >= MAX_HOLD:
            sound = True
            for i in range(STATES):
                if not (x[i] >= -greatest and x[i] <= greatest):
                    sound = False
{_indented(_STOP, 3)}
            if sound:
                if resets < most:
                    resets = resets + 1
            else:
                if broken < most:
                    broken = broken + 1
                gap = 0
        elif pending:
{_indented(_FILTER, 3)}
            sound = True
            for i in range(RESIDUALS):
                if not (residual[i] <= largest and residual[i] >= -largest):
                    sound = False
            if sound:
                pending = False
                passed = True
                known = complete
                if complete:
                    gap = 0
                else:
                    gap = gap + 1
            else:
{_indented(_STOP, 4)}
                if broken < most:
                    broken = broken + 1
                gap = 0
                if fresh:
                    pending = False
"""

#: Estimate of the start from residuals, and the correction of the state by it; how long the filter has run.
LEARN = """
if FIRST > 0:
    if starting and passed:
        if complete:
            for j in range(STATES):
                total = 0.0
                for i in range(RESIDUALS):
                    total = total + residual[i] * start_response[(age * RESIDUALS + i) * STATES + j]
                start_sums[j] = start_sums[j] + total
        else:
            for j in range(STATES):
                start_sums[j] = 0.0
if passed:
    if complete:
        if age < most:
            age = age + 1
    else:
        age = 0
if FIRST > 0:
    if starting and passed and age == FIRST:
        for i in range(STATES):
            total = 0.0
            for j in range(STATES):
                total = total + start_sums[j] * start_correction[i * STATES + j]
            before[i] = total
        for i in range(STATES):
            x[i] = x[i] - before[i]
            start_sums[i] = 0.0
        starting = False
"""

#: A state that is not finite makes the filter start anew; where there is no residual, zeros stand for it.
CHECK = f"""
sound = True
for i in range(STATES):
    if not (x[i] >= -greatest and x[i] <= greatest):
        sound = False
if running and not sound:
{_indented(_STOP, 1)}
    if broken < most:
        broken = broken + 1
    gap = 0
decided = known and age > SETTLE
if not known:
    for i in range(RESIDUALS):
        residual[i] = 0.0
"""

#: The residual in units in which it is white.
WHITEN = """
for j in range(WHITE):
    whitened[j] = 0.0
if decided:
    for i in range(RESIDUALS):
        for j in range(WHITE):
            whitened[j] = whitened[j] + (residual[i] - center[i]) * whitening[i * WHITE + j]
    sound = True
    for j in range(WHITE):
        if not (whitened[j] <= largest_whitened and whitened[j] >= -largest_whitened):
            sound = False
    if not sound:
        decided = False
        for j in range(WHITE):
            whitened[j] = 0.0
"""


MOVING_SUM = """
if WINDOW > 1:
    for j in range(WHITE):
        if window_filled == 0:
            window_begun[j] = whitened[j]
        else:
            window_begun[j] = window_begun[j] + whitened[j]
        sums[j] = window_values[window_filled * WHITE + j] + window_begun[j]
        window_values[window_filled * WHITE + j] = whitened[j]
    if window_filled + 1 < WINDOW:
        window_filled = window_filled + 1
    else:
        window_filled = 0
        for j in range(WHITE):
            later = 0.0
            for i in range(WINDOW):
                value = window_values[(WINDOW - 1 - i) * WHITE + j]
                window_values[(WINDOW - 1 - i) * WHITE + j] = later
                if i == 0:
                    later = value
                else:
                    later = later + value
            window_begun[j] = 0.0
else:
    for j in range(WHITE):
        sums[j] = whitened[j]
"""

#: The same over judged samples alone.
SUM_OF_JUDGED = f"""
if decided:
{_indented(MOVING_SUM, 1)}
else:
    for j in range(WHITE):
        sums[j] = 0.0
"""

NORM = f"""
{SUM_OF_JUDGED.replace("WINDOW", "TEST_WINDOW").replace("window_", "test_")}
total = 0.0
for j in range(WHITE):
    total = total + sums[j] * sums[j]
statistic = sqrt(total)
if TEST_WINDOW > 1:
    statistic = statistic / root
"""

#: Innovations of the whitened residual, for sequential tests.
FORETELL = """
seen = decided
for j in range(WHITE):
    news[j] = whitened[j]
if ORDER > 0:
    for lag in range(ORDER):
        for j in range(WHITE):
            total = 0.0
            for i in range(WHITE):
                total = total + past[(ORDER - 1 - lag) * WHITE + i] * coefficients[(lag * WHITE + i) * WHITE + j]
            news[j] = news[j] - total
        if not past_decided[ORDER - 1 - lag]:
            seen = False
    for lag in range(ORDER - 1):
        for j in range(WHITE):
            past[lag * WHITE + j] = past[(lag + 1) * WHITE + j]
        past_decided[lag] = past_decided[lag + 1]
    for j in range(WHITE):
        past[(ORDER - 1) * WHITE + j] = whitened[j]
    past_decided[ORDER - 1] = decided
    for j in range(WHITE):
        parts[j] = news[j]
    for j in range(WHITE):
        total = 0.0
        for i in range(WHITE):
            total = total + parts[i] * rewhitening[i * WHITE + j]
        news[j] = total
if KNOTS > 0:
    for j in range(WHITE):
        place = 1
        for i in range(KNOTS):
            if i > 1:
                if knots[j * KNOTS + i - 1] < news[j]:
                    place = i
        slope = (scores[place] - scores[place - 1]) / (knots[j * KNOTS + place] - knots[j * KNOTS + place - 1])
        news[j] = scores[place - 1] + slope * (news[j] - knots[j * KNOTS + place - 1])
decided = seen
statistic = 0.0
"""

PAGE = """
if seen:
    for j in range(2 * WHITE):
        if j < WHITE:
            total = sums[j] + (news[j] - allowance)
        else:
            total = sums[j] + (-news[j - WHITE] - allowance)
        if not (total > 0.0):
            total = 0.0
        if not (total < full):
            total = full
        sums[j] = total
        if total > statistic:
            statistic = total
"""

CROSIER = """
if seen:
    total = 0.0
    for j in range(WHITE):
        sums[j] = sums[j] + news[j]
        total = total + sums[j] * sums[j]
    size = sqrt(total)
    statistic = size - allowance
    if not (statistic > 0.0):
        statistic = 0.0
    if not (statistic < full):
        statistic = full
    total = 0.0
    if size > 0.0:
        total = statistic / size
    for j in range(WHITE):
        sums[j] = sums[j] * total
"""

PIGNATIELLO_RUNGER = """
if seen:
    total = 0.0
    for j in range(WHITE):
        sums[j] = sums[j] + news[j]
        total = total + sums[j] * sums[j]
    size = sqrt(total)
    sums[WHITE] = sums[WHITE] + 1.0
    statistic = size - allowance * sums[WHITE]
    if not (statistic > 0.0):
        statistic = 0.0
    if statistic > full:
        total = (full + allowance * sums[WHITE]) / size
        for j in range(WHITE):
            sums[j] = sums[j] * total
    if not (statistic < full):
        statistic = full
    if not (statistic > 0.0):
        for j in range(WHITE + 1):
            sums[j] = 0.0
"""

#: An alarm of cumulated sums that is over starts them again.
AGAIN = """
if seen:
    if statistic > threshold:
        raised = True
    if raised and statistic <= release_level:
        for j in range(SUMS):
            sums[j] = 0.0
        raised = False
"""

EWMA = """
total = 0.0
for j in range(WHITE):
    if seen:
        sums[j] = old_weight * sums[j] + new_weight * news[j]
    total = total + sums[j] * sums[j]
statistic = sqrt(total) / deviation_of_average
"""


def means(of_part: bool) -> str:
    """Return the square of the longest mean of the residual, or of part ``m`` of it: clipped, averaged and scaled."""

    def each(level: int, letter: str, *lines: str) -> str:
        wanted = [f"if part_of_column[{letter}] == m:"] if of_part else []
        deeper = ["    " * len(wanted) + line for line in lines]
        made = [f"for {letter} in range(WHITE):", *("    " + line for line in (*wanted, *deeper))]
        return "\n".join("    " * level + line for line in made)

    which = "m" if of_part else "0"
    return f"""
total = 0.0
{each(0, "j", "total = total + news[j] * news[j]")}
slope = 1.0
if total > clips[{which}] * clips[{which}]:
    slope = clips[{which}] / sqrt(total)
at_rest = True
{each(0, "j", "if news[j] != 0.0:", "    at_rest = False")}
square = 0.0
for s in range(SCALES):
    if s > 0:
{each(2, "j", *_NEW_MEAN)}
    else:
{each(2, "j", "latest[j] = news[j]")}
    value = 0.0
{each(1, "c", "later = 0.0", *_SCALED, "value = value + later * later")}
    if s > 0 and value > fulls[{which}] * fulls[{which}]:
        scaled = fulls[{which}] / sqrt(value)
{each(2, "j", "sums[(s - 1) * WHITE + j] = sums[(s - 1) * WHITE + j] * scaled")}
        value = fulls[{which}] * fulls[{which}]
    if value > square:
        square = value
"""


_NEW_MEAN = (
    "later = old_weights[s] * sums[(s - 1) * WHITE + j] + mean_weights[s] * (news[j] * slope)",
    "if at_rest and later < smallest and later > -smallest:",
    "    later = 0.0",
    "sums[(s - 1) * WHITE + j] = later",
    "latest[j] = later",
)
_SCALED = (
    "for j in range(WHITE):",
    "    later = later + latest[j] * scaling[(s * WHITE + j) * WHITE + c]",
)

#: A bank of exponentially weighted means.
MEANS = f"""
if seen:
{_indented(means(of_part=False), 1)}
    statistic = sqrt(square)
"""

#: Of the last samples that were seen: their squares, themselves, or their parts along directions.
CHI_SQUARED = """
if seen:
    latest[0] = 0.0
    for j in range(WHITE):
        latest[0] = latest[0] + news[j] * news[j]
    total = latest[0]
    for i in range(TEST_WINDOW - 1):
        total = total + sums[TEST_WINDOW - 2 - i]
    statistic = sqrt(total)
"""

_LARGEST_SUM = """
    for j in range(WIDTH):
        parts[j] = 0.0
    for i in range(TEST_WINDOW):
        if i == 0:
            for j in range(WIDTH):
                parts[j] = parts[j] + latest[j]
        else:
            for j in range(WIDTH):
                parts[j] = parts[j] + sums[(TEST_WINDOW - 1 - i) * WIDTH + j]
        SIZE
        size = size / roots[i]
        if i == 0 or size > statistic:
            statistic = size
"""

_LENGTH = """
        total = 0.0
        for j in range(WIDTH):
            total = total + parts[j] * parts[j]
        size = sqrt(total)
"""

_PART = """
        size = 0.0
        for j in range(WIDTH):
            if abs(parts[j]) > size:
                size = abs(parts[j])
"""

GLR = f"""
if seen:
    for j in range(WHITE):
        latest[j] = news[j]
{_LARGEST_SUM.replace("        SIZE", _LENGTH)}
"""

DIRECTED_GLR = f"""
if seen:
    for j in range(WIDTH):
        total = 0.0
        for i in range(WHITE):
            total = total + news[i] * along[i * WIDTH + j]
        latest[j] = total
{_LARGEST_SUM.replace("        SIZE", _PART)}
"""

#: The window of the last samples that were seen goes on.
KEEP = """
if seen:
    if TEST_WINDOW > 1:
        for i in range(TEST_WINDOW - 2):
            for j in range(WIDTH):
                sums[i * WIDTH + j] = sums[(i + 1) * WIDTH + j]
        for j in range(WIDTH):
            sums[(TEST_WINDOW - 2) * WIDTH + j] = latest[j]
"""

#: Persistence of a threshold, or the two levels of a sequential test.
ALARM = """
over = decided and statistic > threshold
if decided:
    if over:
        if above < most:
            above = above + 1
        below = 0
    else:
        above = 0
        if below < most:
            below = below + 1
    if REMEMBERS > 0:
        if over or statistic <= release_level:
            standing = over
    else:
        if over:
            if above >= PERSISTENCE:
                standing = True
        else:
            if below >= RELEASE:
                standing = False
else:
    statistic = 0.0
alarm = standing
"""

#: The longest mean of the residual that is clear of noise.
CLEAR_MEAN = """
total = 0.0
at_rest = True
for j in range(WHITE):
    averaged[j] = 0.0
    if decided:
        averaged[j] = whitened[j]
        total = total + whitened[j] * whitened[j]
        if whitened[j] != 0.0:
            at_rest = False
if decided:
    value = total
    for s in range(LONG_MEANS):
        total = 0.0
        for j in range(WHITE):
            later = long_old_weights[s] * naming_values[s * WHITE + j] + long_weights[s] * whitened[j]
            naming_values[s * WHITE + j] = later
            total = total + later * later
        total = total * long_factors[s]
        better = total > clear or total >= value
        if better:
            value = total
        for j in range(WHITE):
            later = naming_values[s * WHITE + j]
            if better:
                averaged[j] = later
            if at_rest and later < smallest and later > -smallest:
                naming_values[s * WHITE + j] = 0.0
"""

#: The sum of the residual over a window.
AVERAGE = SUM_OF_JUDGED.replace("WINDOW", "NAMING_WINDOW").replace("window_", "naming_").replace("sums[", "averaged[")

#: How well each group's signature explains the averaged residual, and the group that does it best: of scores that agree
#: to three digits the narrower signature, of equally narrow ones the larger score.
NAME = """
total = 0.0
for j in range(WHITE):
    total = total + averaged[j] * averaged[j]
size = sqrt(total)
scored = alarm and decided and size > 0.0
best = 0
best_rounded = 0.0
for g in range(GROUPS):
    score[g] = 0.0
if scored:
    for g in range(GROUPS):
        square = 0.0
        for c in range(COLUMNS):
            if group_of_column[c] == g:
                total = 0.0
                for j in range(WHITE):
                    total = total + averaged[j] * bases[j * COLUMNS + c]
                square = square + total * total
        score[g] = sqrt(square) / size
        if not (score[g] < 1.0):
            score[g] = 1.0
        scaled = score[g] * 1000.0
        rounded = 0.0
        part = 512.0
        odd = False
        for i in range(10):
            odd = False
            if scaled >= rounded + part:
                rounded = rounded + part
                odd = True
            part = part / 2.0
        if scaled - rounded > 0.5 or (scaled - rounded == 0.5 and odd):
            rounded = rounded + 1.0
        better = best == 0
        if best > 0:
            if rounded > best_rounded:
                better = True
            if rounded == best_rounded:
                if dimension[g] < dimension[best - 1]:
                    better = True
                if dimension[g] == dimension[best - 1] and score[g] > score[best - 1]:
                    better = True
        if better:
            best = g + 1
            best_rounded = rounded
"""
