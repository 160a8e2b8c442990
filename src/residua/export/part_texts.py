"""Steps of a monitor on each sample if parts of the residual are tested separately; see :mod:`step_texts`."""

from residua.export.step_texts import AVERAGE, CLEAR_MEAN, MOVING_SUM, NAME, NORM, _indented as indented, means

#: The residual in the units in which the direction of all of it is judged.
OVERALL = """
for j in range(OVERALL):
    overall[j] = 0.0
if decided:
    for i in range(RESIDUALS):
        for j in range(OVERALL):
            overall[j] = overall[j] + (residual[i] - center[i]) * whole[i * OVERALL + j]
"""

#: The norm of each part; the statistic is the largest ratio of one to its own threshold.
NORMS = f"""
{NORM[: NORM.index("total = 0.0")]}
statistic = 0.0
for m in range(PARTS):
    total = 0.0
    for j in range(WHITE):
        if part_of_column[j] == m:
            total = total + sums[j] * sums[j]
    part_statistic[m] = sqrt(total)
    if TEST_WINDOW > 1:
        part_statistic[m] = part_statistic[m] / root
for m in range(PARTS):
    value = part_statistic[m] / part_threshold[m]
    if value > statistic:
        statistic = value
"""

_OVER = """\
else:
    statistic = 0.0
    for m in range(PARTS):
        part_statistic[m] = 0.0
alarm = False
for m in range(PARTS):
    fired[m] = part_standing[m]
    if part_standing[m]:
        alarm = True\
"""

#: Persistence of each part; all together are in alarm while one is.
ALARMS = f"""
if decided:
    for m in range(PARTS):
        if part_statistic[m] > part_threshold[m]:
            if part_above[m] < most:
                part_above[m] = part_above[m] + 1
            part_below[m] = 0
            if part_above[m] >= PERSISTENCE:
                part_standing[m] = True
        else:
            part_above[m] = 0
            if part_below[m] < most:
                part_below[m] = part_below[m] + 1
            if part_below[m] >= RELEASE:
                part_standing[m] = False
{_OVER}
"""

#: The longest mean of each part.
MEANS = f"""
if seen:
    for m in range(PARTS):
{indented(means(of_part=True), 2)}
        part_statistic[m] = sqrt(square)
        value = part_statistic[m] / part_threshold[m]
        if value > statistic:
            statistic = value
"""

#: Two levels of each part; all together are in alarm while one is.
MEAN_ALARMS = f"""
if decided:
    for m in range(PARTS):
        if part_statistic[m] > part_threshold[m]:
            part_standing[m] = True
        elif part_statistic[m] <= part_release[m]:
            part_standing[m] = False
{_OVER}
"""

AVERAGE_OVERALL = AVERAGE.replace("whitened[", "overall[").replace("WHITE", "OVERALL")
CLEAR_MEAN_OVERALL = CLEAR_MEAN.replace("whitened[", "overall[").replace("WHITE", "OVERALL")
NAME_OVERALL = NAME.replace("WHITE", "OVERALL")

#: Which parts count as fired: those in alarm for long enough, compared with the one that was the longest.
CODE = f"""
for m in range(PARTS):
    flagged[m] = 0.0
    if fired[m] and decided:
        flagged[m] = 1.0
{
    MOVING_SUM.replace("WINDOW", "CODE_WINDOW")
    .replace("window_", "code_")
    .replace("sums[", "counted[")
    .replace("whitened[", "flagged[")
    .replace("WHITE", "PARTS")
}
size = 0.0
for m in range(PARTS):
    if counted[m] > size:
        size = counted[m]
scored = False
for m in range(PARTS):
    if AT_ONCE > 0:
        code[m] = fired[m]
    else:
        code[m] = alarm and counted[m] > 0.0 and counted[m] >= share * size
    if code[m]:
        scored = True
scored = scored and decided
"""

#: The code against those of the faults, in the order of :func:`residua.decide.read_code`.
READ = """
best = 0
answer = 0
for g in range(GROUPS):
    score[g] = 0.0
if scored:
    smallest_distance = PARTS + 1
    nearest = 0
    for g in range(GROUPS):
        total = 0.0
        place = 0
        covers = True
        for m in range(PARTS):
            if code_table[m * GROUPS + g] > 0:
                if code[m]:
                    total = total + 1.0
                else:
                    place = place + 1
            else:
                if code[m]:
                    place = place + 1
                    covers = False
                else:
                    total = total + 1.0
        score[g] = total / number_of_parts
        distance_to[g] = place
        covering[g] = covers
        if place < smallest_distance:
            smallest_distance = place
            nearest = g
    whole_code = True
    owned = True
    for m in range(PARTS):
        if not code[m]:
            whole_code = False
        if code[m] and part_owned[m] == 0:
            owned = False
    if smallest_distance == 0:
        answer = 1
        best = nearest + 1
    else:
        if DEDICATED > 0 and owned:
            answer = 2
        else:
            leader = 0
            lone = True
            place = PARTS + 1
            for g in range(GROUPS):
                if covering[g]:
                    if leader == 0:
                        leader = class_of_group[g]
                    if class_of_group[g] != leader:
                        lone = False
                    if distance_to[g] < place:
                        place = distance_to[g]
                        best = g + 1
            if STRONG > 0 and lone and leader > 0:
                answer = 3
            else:
                lone = not whole_code and smallest_distance <= DISTANCE
                for g in range(GROUPS):
                    if distance_to[g] == smallest_distance and class_of_group[g] != class_of_group[nearest]:
                        lone = False
                    if covering[g] and contained[nearest * GROUPS + g] == 0:
                        lone = False
                if lone:
                    answer = 4
                    best = nearest + 1
                else:
                    answer = 5
                    best = 0
"""
