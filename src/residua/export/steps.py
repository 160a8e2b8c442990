"""Steps of a monitor on each sample, as text of :mod:`residua.export.program`, in the order of the fused loop's sums.

Names in capitals are sizes, and settings that are known when a monitor is exported. Windows have the latest row first.
"""

#: Deviations from the operating point, the filter, and the residual in units in which it is white.
FILTER = """
def take():  # values outside of the plausible range, or NaN, are missing
    signals = join(u, y)
    deviation = signals - offset
    plausible = deviation >= lowest and deviation <= highest
    held = where(plausible, deviation, held)
    complete = all(plausible)

def stop():
    running = False
    starting = False
    x = 0.0
    if FIRST > 0:
        start_sums = 0.0

def start():
    stop()
    x = start_matrix @ held
    running = True
    starting = FIRST > 0
    age = 0
    gap = 0
    fresh = True

def overflow():
    broken = min(broken + 1, most)
    gap = 0

def filter():
    before = x
    residual = feed_matrix @ held + output_matrix @ before
    x = input_matrix @ held + state_matrix @ before
    if STATES > 0:
        at_rest = all(held == 0.0)
        if at_rest:
            x = where(x < smallest and x > -smallest, 0.0, x)

def run():  # starts, holds missing values, restarts after long gaps and overflows; twice at most: after a start
    known = False
    passed = False
    pending = True
    for attempt in range(2):
        if pending:
            fresh = False
            if not running:
                if complete:
                    start()
                else:
                    gap = min(gap + 1, most)
                    pending = False
            if pending and not complete and gap >= MAX_HOLD:
                sound = all(x >= -greatest and x <= greatest)
                stop()
                if sound:
                    resets = min(resets + 1, most)
                else:
                    overflow()
            elif pending:
                filter()
                sound = all(residual <= largest_residual and residual >= -largest_residual)
                if sound:
                    pending = False
                    passed = True
                    known = complete
                    if complete:
                        gap = 0
                    else:
                        gap = gap + 1
                else:
                    stop()
                    overflow()
                    if fresh:
                        pending = False

def learn():  # the state is corrected by what the first residuals say of its start
    if FIRST > 0:
        if starting and passed:
            if complete:
                said = residual @ start_response[age]
                start_sums = start_sums + said
            else:
                start_sums = 0.0
    if passed:
        if complete:
            age = min(age + 1, most)
        else:
            age = 0
    if FIRST > 0:
        if starting and passed and age == FIRST:
            correction = start_correction @ start_sums
            x = x - correction
            start_sums = 0.0
            starting = False

def check():  # a state that is not finite makes the filter start anew
    sound = all(x >= -greatest and x <= greatest)
    if running and not sound:
        stop()
        overflow()
    decided = known and age > SETTLE
    if not known:
        residual = 0.0

def whiten():
    whitened = zeros(WHITE)
    if decided:
        whitened = (residual - center) @ whitening
        sound = all(whitened <= largest_whitened and whitened >= -largest_whitened)
        if not sound:
            decided = False
            whitened = 0.0
"""

#: Statistics: of all parts of the residual that are tested by themselves, or one number.
STATISTICS = """
def moving_sum(window, values, first, filled, row, total):  # sums of rows before the first of the window, and after it
    if window > 1:
        if filled == 0:
            first = row
        else:
            first = first + row
        total = values[filled] + first
        values[filled] = row
        filled = filled + 1
        if filled == window:
            filled = 0
            values = later_sums(values)
            first = 0.0
    else:
        total = row

def norm():
    if decided:
        moving_sum(TEST_WINDOW, test_values, test_begun, test_filled, whitened, sums)
    else:
        sums = zeros(WHITE)
    part_statistic = summed(sums * sums, part_of_column, PARTS)
    part_statistic = sqrt(part_statistic)
    if TEST_WINDOW > 1:
        part_statistic = part_statistic / root

def innovate():  # innovations of the whitened residual by its autoregression, as normal scores
    seen = decided
    news = whitened
    if ORDER > 0:
        for lag in range(ORDER):
            expected = past[lag] @ coefficients[lag]
            news = news - expected
            if not past_decided[lag]:
                seen = False
        past = pushed(whitened, past)
        past_decided = pushed(decided, past_decided)
        plain = news
        news = plain @ rewhitening
    if KNOTS > 0:
        for k in range(WHITE):
            place = count(inner_knots[k] < news[k])
            slope = (scores[place + 1] - scores[place]) / (knots[k][place + 1] - knots[k][place])
            news[k] = scores[place] + slope * (news[k] - knots[k][place])
    decided = seen
    statistic = 0.0
    part_statistic = zeros(PARTS)

def page():
    if seen:
        both = join(news, -news)
        sums = sums + (both - allowance)
        sums = where(sums > 0.0, sums, 0.0)
        sums = where(sums < full, sums, full)
        statistic = largest(sums)

def crosier():
    if seen:
        sums = sums + news
        square = sum(sums * sums)
        size = sqrt(square)
        statistic = size - allowance
        statistic = where(statistic > 0.0, statistic, 0.0)
        statistic = where(statistic < full, statistic, full)
        shrunk = 0.0
        if size > 0.0:
            shrunk = statistic / size
        sums = sums * shrunk

def pignatiello_runger():
    if seen:
        sums = sums + news
        square = sum(sums * sums)
        size = sqrt(square)
        length = length + 1.0
        statistic = size - allowance * length
        statistic = where(statistic > 0.0, statistic, 0.0)
        if statistic > full:
            shrunk = (full + allowance * length) / size
            sums = sums * shrunk
        statistic = where(statistic < full, statistic, full)
        if not statistic > 0.0:
            sums = 0.0
            length = 0.0

def again():  # an alarm of cumulated sums that is over starts them again
    if seen:
        raised = raised or statistic > threshold
        if raised and statistic <= release_level:
            sums = 0.0
            if KEEPS_LENGTH > 0:
                length = 0.0
            raised = False

def ewma():
    if seen:
        sums = old_weight * sums + new_weight * news
    square = sum(sums * sums)
    statistic = sqrt(square) / deviation_of_average

def means():  # the longest of some exponentially weighted means of clipped samples
    if seen:
        squares = summed(news * news, part_of_column, PARTS)
        slopes = where(squares > clips * clips, clips / sqrt(squares), 1.0)
        sizes = summed(abs(news), part_of_column, PARTS)
        still = sizes == 0.0
        longest = zeros(PARTS)
        for s in range(SCALES):
            if s > 0:
                latest = old_weights[s] * sums[s - 1] + mean_weights[s] * (news * slopes[part_of_column])
                tiny = still[part_of_column] and latest < smallest and latest > -smallest
                latest = where(tiny, 0.0, latest)
                sums[s - 1] = latest
            else:
                latest = news
            scaled = latest @ scaling[s]
            squares = summed(scaled * scaled, part_of_column, PARTS)
            if s > 0:
                grown = squares > fulls * fulls
                shrink = where(grown, fulls / sqrt(squares), 1.0)
                sums[s - 1] = where(grown[part_of_column], sums[s - 1] * shrink[part_of_column], sums[s - 1])
                squares = where(grown, fulls * fulls, squares)
            longest = where(squares > longest, squares, longest)
        part_statistic = sqrt(longest)

def chi_squared():
    if seen:
        square = sum(news * news)
        recent = pushed(square, recent)
        total = sum(recent)
        statistic = sqrt(total)

def glr():  # the longest sum back from now
    if seen:
        recent = pushed(news, recent)
        reached = zeros(WHITE)
        for k in range(TEST_WINDOW):
            reached = reached + recent[k]
            square = sum(reached * reached)
            size = sqrt(square) / roots[k]
            statistic = where(size > statistic, size, statistic)

def directed_glr():
    if seen:
        parts = news @ along
        recent = pushed(parts, recent)
        reached = zeros(ALONG)
        for k in range(TEST_WINDOW):
            reached = reached + recent[k]
            sizes = abs(reached)
            size = largest(sizes)
            size = size / roots[k]
            statistic = where(size > statistic, size, statistic)

def of_all():
    part_statistic = zeros(1)
    part_statistic[0] = statistic

def of_parts():
    if APART > 0:
        ratio = part_statistic / part_threshold
        statistic = largest(ratio)
    else:
        statistic = part_statistic[0]

def judge():  # persistence over a threshold, or two levels
    if decided:
        over = part_statistic > part_threshold
        if REMEMBERS > 0:
            standing = where(over or part_statistic <= part_release, over, standing)
        else:
            above = min(above + 1, most)
            above = where(over, above, 0)
            below = min(below + 1, most)
            below = where(over, 0, below)
            standing = (standing or above >= PERSISTENCE) and below < RELEASE
    else:
        statistic = 0.0
        part_statistic = 0.0
    if APART > 0:
        fired = standing
    alarm = any(standing)
"""

#: The fault by the direction of the residual, or by the parts that are in alarm.
NAMING = """
def view_all():  # the residual in the units in which the direction of all of it is judged
    overall = zeros(OVERALL)
    if decided:
        overall = (residual - center) @ whole

def average(row, WIDTH):
    if decided:
        moving_sum(NAMING_WINDOW, naming_values, naming_begun, naming_filled, row, averaged)
    else:
        averaged = zeros(WIDTH)

def clear_mean(row, WIDTH):  # the longest mean of the residual that is clear of noise
    averaged = zeros(WIDTH)
    if decided:
        averaged = row
        best_square = sum(row * row)
        at_rest = all(row == 0.0)
        for s in range(LONG_MEANS):
            mean = long_old_weights[s] * naming_values[s] + long_weights[s] * row
            square = sum(mean * mean)
            square = square * long_factors[s]
            if square > clear or square >= best_square:
                best_square = square
                averaged = mean
            if at_rest:
                mean = where(mean < smallest and mean > -smallest, 0.0, mean)
            naming_values[s] = mean

def name():  # of scores that agree to three digits the narrower signature, of equally narrow ones the larger score
    square = sum(averaged * averaged)
    size = sqrt(square)
    scored = alarm and decided and size > 0.0
    best = 0
    score = 0.0
    if scored:
        parallel = averaged @ bases
        score = summed(parallel * parallel, group_of_column, GROUPS)
        score = sqrt(score) / size
        score = where(score < 1.0, score, 1.0)
        scaled_score = score * 1000.0
        rounded = zeros(GROUPS)
        part = 512.0
        for k in range(10):
            odd = scaled_score >= rounded + part
            rounded = where(odd, rounded + part, rounded)
            part = part / 2.0
        rest = scaled_score - rounded
        rounded = where(rest > 0.5 or (rest == 0.5 and odd), rounded + 1.0, rounded)
        best_rounded = -1.0
        best_dimension = 0
        best_score = 0.0
        for g in range(GROUPS):
            narrower = dimension[g] < best_dimension or (dimension[g] == best_dimension and score[g] > best_score)
            if rounded[g] > best_rounded or (rounded[g] == best_rounded and narrower):
                best = g + 1
                best_rounded = rounded[g]
                best_dimension = dimension[g]
                best_score = score[g]

def count_fired():  # parts in alarm for long enough, compared with the one that was the longest
    flagged = zeros(PARTS)
    flagged = where(fired and decided, 1.0, 0.0)
    moving_sum(CODE_WINDOW, code_values, code_begun, code_filled, flagged, counted)
    most_counted = largest(counted)
    if AT_ONCE > 0:
        code = fired
    else:
        code = alarm and counted > 0.0 and counted >= share * most_counted
    scored = any(code)
    scored = scored and decided

def read():  # the code against those of the faults, in the order of residua.decide.read_code
    best = 0
    answer = 0
    score = 0.0
    if scored:
        ones = zeros(PARTS)
        ones = where(code, 1.0, 0.0)
        number_fired = sum(ones)
        common = ones @ code_table
        distance = number_fired + code_sizes - 2.0 * common
        score = (number_of_parts - distance) / number_of_parts
        covering = common == number_fired
        smallest_distance = number_of_parts + 1.0
        nearest = 0
        for g in range(GROUPS):
            if distance[g] < smallest_distance:
                smallest_distance = distance[g]
                nearest = g
        whole_code = all(code)
        stray = any(code and part_owned == 0)
        if smallest_distance == 0.0:
            answer = 1
            best = nearest + 1
        elif DEDICATED > 0 and not stray:
            answer = 2
        else:
            leader = 0
            lone = True
            least = number_of_parts + 1.0
            for g in range(GROUPS):
                if covering[g]:
                    if leader == 0:
                        leader = class_of_group[g]
                    if class_of_group[g] != leader:
                        lone = False
                    if distance[g] < least:
                        least = distance[g]
                        best = g + 1
            if STRONG > 0 and lone and leader > 0:
                answer = 3
            else:
                alike = distance == smallest_distance and class_of_group != class_of_group[nearest]
                beyond = any(alike or (covering and contained[nearest] == 0))
                if not whole_code and smallest_distance <= DISTANCE and not beyond:
                    answer = 4
                    best = nearest + 1
                else:
                    answer = 5
                    best = 0
"""

TEXT = FILTER + STATISTICS + NAMING

__all__ = ["TEXT"]
