"""Two robots on one bus, moved at the same time by the asynchronous client.

For the second one, in another terminal: `zarm up --name second --connect tcp/127.0.0.1:7447`
"""

import asyncio

import zarm
import zarm.aio

HOME = (0.0, 0.0, 1.5708, 0.0, 1.5708, 0.0)


async def swing(name: str, angle: float) -> None:
    """Turn the first joint of one robot by an angle (rad), and back."""
    async with zarm.aio.connect(name=name) as robot:
        for target in (HOME, (angle, *HOME[1:]), HOME):
            last = await robot.execute(await robot.plan(target))
            print(f"{name}: {last.status} after {last.elapsed:.2f} s")


async def main() -> None:
    """Move all the robots that there are."""
    names = await zarm.aio.robots()
    print("on the bus:", ", ".join(names))
    await asyncio.gather(*(swing(name, 0.4 + 0.2 * i) for i, name in enumerate(names)))


asyncio.run(main())
