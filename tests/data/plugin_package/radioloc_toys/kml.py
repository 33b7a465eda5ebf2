"""Export of solutions as KML, ``radioloc export solution.json lander.kml``."""

from radioloc.io import Exporter
from radioloc.results import contents_by_target


def write(path, solutions, options):
    places = []
    for content in contents_by_target(solutions):
        me = content["position"]["me"]
        point = f"<coordinates>{me['longitude_deg']:.9f},{me['latitude_deg']:.9f}</coordinates>"
        places.append(f"<Placemark><name>{content['name']}</name><Point>{point}</Point></Placemark>")
    path.write_text(
        f'<kml xmlns="http://www.opengis.net/kml/2.2"><Document>{"".join(places)}</Document></kml>\n'
    )
    return [path]


KML = Exporter("KML", (".kml",), "places for map viewers", write)
