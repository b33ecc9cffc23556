"""RRT-Connect of OMPL with the package's contact check."""

from ompl import base, geometric, util

util.setLogLevel(util.LogLevel.LOG_ERROR if hasattr(util.LogLevel, "LOG_ERROR") else util.LOG_ERROR)


class Free(base.StateValidityChecker):
    def __init__(self, information, around, joints):
        super().__init__(information)
        self.around, self.joints = around, joints

    def isValid(self, state):
        return not self.around.contacts([state[k] for k in range(self.joints)])[0]


class FreeLines(base.MotionValidator):
    """Lines are proven free at every instant, by the same check that the package uses itself."""

    def __init__(self, information, around, joints):
        super().__init__(information)
        self.around, self.joints = around, joints

    def checkMotion(self, one, other):
        ends = ([state[k] for k in range(self.joints)] for state in (one, other))
        return self.around.is_free_line(*ends)


class Planner:
    """One arm in one scene."""

    def __init__(self, robot, around):
        self.joints = len(robot.joint_names)
        space = base.RealVectorStateSpace(self.joints)
        bounds = base.RealVectorBounds(self.joints)
        for k in range(self.joints):
            bounds.setLow(k, robot.q_min_rad[k])
            bounds.setHigh(k, robot.q_max_rad[k])
        space.setBounds(bounds)
        self.space, self.information = space, base.SpaceInformation(space)
        # Both are held here too: the binding does not keep them alive.
        self.free = Free(self.information, around, self.joints)
        self.lines = FreeLines(self.information, around, self.joints)
        self.information.setStateValidityChecker(self.free)
        self.information.setMotionValidator(self.lines)
        self.information.setup()

    def corners(self, start, goal, limit_s):
        """Corners of a simplified path; `None` if none was found."""
        ends = [self.space.allocState(), self.space.allocState()]
        for state, q_rad in zip(ends, (start, goal)):
            for k in range(self.joints):
                state[k] = float(q_rad[k])
        setup = geometric.SimpleSetup(self.information)
        setup.setStartAndGoalStates(*ends)
        setup.setPlanner(geometric.RRTConnect(self.information))
        setup.solve(limit_s)
        if not setup.haveExactSolutionPath():
            return None
        setup.simplifySolution()
        states = setup.getSolutionPath().getStates()
        return [[state[k] for k in range(self.joints)] for state in states]


def seed(number):
    util.RNG.setSeed(number)
